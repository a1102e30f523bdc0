"""The import of Pinocchio, put off until a robot is read."""


def import_pinocchio():
    """Import pinocchio, or say in one line how to get it."""
    try:
        import pinocchio
    except ImportError as error:
        raise ImportError(
            "Robot models need Pinocchio, which is not installed: "
            'pip install "sklearn-vbjfa[robot]"'
        ) from error
    return pinocchio

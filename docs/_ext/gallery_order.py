"""Order of the examples on the page that lists them."""

FIRST = (
    "plot_identify_demo.py",
    "plot_not_level.py",
    "plot_mujoco.py",
    "plot_gridsearch_regressors.py",
    "plot_commands_alone.py",
    "plot_gravity.py",
    "plot_design_motion.py",
    "plot_known_noise.py",
    "plot_ting2011_synthetic.py",
)


class MostWantedFirst:
    """Sorting key: the examples named above in their order, then all others.

    Parameters
    ----------
    src_dir : str
        Folder of the examples; not used.
    """

    def __init__(self, src_dir):
        self.src_dir = src_dir

    def __call__(self, filename):
        """Return the key of a file."""
        place = FIRST.index(filename) if filename in FIRST else len(FIRST)
        return place, filename

    def __repr__(self):
        # Sphinx-Gallery rebuilds if this changes.
        return f"<{type(self).__name__}: {', '.join(FIRST)}>"

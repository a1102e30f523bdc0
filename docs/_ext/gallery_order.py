"""Order of the examples on the page that lists them."""

FIRST = (
    "plot_what_is_missing.py",
    "plot_identify_demo.py",
    "plot_measured_robots.py",
    "plot_not_level.py",
    "plot_mujoco.py",
    "plot_pipeline.py",
    "plot_known_noise.py",
    "plot_noisy_sensors.py",
    "plot_replicates.py",
    "plot_ting2011_synthetic.py",
    "plot_ting2011_head.py",
    "plot_ting2011_arm.py",
)


class MostWantedFirst:
    """Key of sorting: the examples named above in their order, then all others.

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
        # Sphinx-Gallery builds anew when this changes.
        return f"<{type(self).__name__}: {', '.join(FIRST)}>"

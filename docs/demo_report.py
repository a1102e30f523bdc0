"""Write the report on the recording that comes with the package, as a page.

Run ``python docs/demo_report.py``; it takes about fifteen seconds and writes
``demo-report.html`` beside itself, which README and guide link.
"""

from pathlib import Path

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.robot import FitOptions

PAGE = Path(__file__).with_name("demo-report.html")


def page():
    """Return the page of the report that ``python -m sklearn_vbjfa`` prints."""
    recording = load_demo_recording()
    options = FitOptions(torque_noise=recording.torque_noise)
    declared = RobotIdentifier(recording.urdf, dt=recording.dt, options=options)
    loop = EffectDiscovery(declared, random_state=0)
    loop.fit(recording.q, recording.tau, groups=recording.groups)
    return loop.report_.to_html()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

"""Pages of the effects: one for each, and what they say is what the code computes."""

import io
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.report import explanation, source_of
from tests.effects._arms import (
    arm,
    dahl_in_small_steps,
    inverse_dynamics,
    play_sample_by_sample,
    with_changed_body,
)
from tests.effects.test_effects import RECORDED, A, Q, T, V, X, signals

pytest.importorskip("pinocchio")

DOCS = Path(__file__).resolve().parents[1] / "docs"
sys.path.insert(0, str(DOCS / "_ext"))
import effect_facts  # noqa: E402
import simulated_effects  # noqa: E402

NAMES = effects.available()
USES = simulated_effects.uses()
PARTS = ("law", "picture", "rivals", "facts")
# What formulas hold beside parameters, and every page may take for granted.
SIGNALS = {"q", "v", "a", "t", "tau", "tauload", "sign", "pi", "e", "i", "g", "d"}
SIGNALS |= {"qj", "vj", "aj", "tauj"}


def page(name):
    return (DOCS / "effects" / f"{name}.rst").read_text(encoding="utf-8")


# -- the pages ---------------------------------------------------------------------


def test_every_effect_has_a_page_and_every_page_an_effect():
    pages = {path.stem for path in (DOCS / "effects").glob("*.rst")}
    assert pages == set(NAMES) == set(USES)
    guide = (DOCS / "effects.rst").read_text(encoding="utf-8")
    assert re.findall(r"^    effects/(\w+)$", guide, flags=re.M) == list(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_its_parts_and_links_to_others(name):
    text = page(name)
    (effect,) = effects.resolve(name)
    title, line = text.splitlines()[:2]
    assert title.lower() == effect.label.lower()
    assert line == "=" * len(title)
    assert re.findall(r"^\.\. effect-(\w+):: (\w+)$", text, flags=re.M) == [
        (part, name) for part in PARTS
    ]
    links = re.findall(r":doc:`[^<`]+<([^>]+)>`|:doc:`([^<`]+)`", text)
    for link in map("".join, links):
        assert link != name
        assert (DOCS / "effects" / f"{link}.rst").is_file(), link


@pytest.mark.parametrize("name", NAMES)
def test_what_stands_in_a_formula_is_a_parameter_or_is_explained(name):
    use = USES[name]
    told = page(name) + " ".join(explanation(type(use.effect)))
    parameters = effect_facts.parameters_of(use)
    formula = effect_facts.symbols(use.effect.formula)
    explained = effect_facts.symbols(
        " ".join(re.findall(r":math:`([^`]*)`", told.replace("\n", " ")))
    )
    words = set(re.findall(r"\w+", told))
    for symbol in formula - set(parameters) - SIGNALS:
        assert symbol in explained | words, symbol
    for symbol, (units, _) in parameters.items():
        if units:
            assert symbol in formula | words, symbol


@pytest.mark.parametrize("name", NAMES)
def test_sources_are_in_the_bibliography(name):
    (effect,) = effects.resolve(name)
    bibliography = " ".join((DOCS / "references.bib").read_text("utf-8").split())
    source = source_of(type(effect))
    assert source
    for doi in re.findall(r":doi:`([^`]+)`", source):
        assert doi in bibliography, doi
    title = re.search('"([^"]+)"', source)[1]
    plain = re.sub(r"[{}]", "", bibliography).lower()
    assert title.lower() in plain, title


@pytest.mark.parametrize("name", ["viscous", "coulomb", "offset"])
def test_published_sizes_are_those_of_the_table(name):
    table = (DOCS / "tables" / "protocol_emps.rst").read_text("utf-8")
    label = {"viscous": "Fv", "coulomb": "Fc", "offset": "offset"}[name]
    unit = {"viscous": "N s/m", "coulomb": "N", "offset": "N"}[name]
    published = re.search(rf"^{label} \[{unit}\]\s+(\S+)", table, flags=re.M)[1]
    told = re.search(rf"^(-?[\d.]+) {unit} on the linear drive", page(name), re.M)[1]
    assert float(told) == round(float(published), len(told.partition(".")[2]))


# -- the formulas ------------------------------------------------------------------


def tilted(turn):
    model = arm("ZY")
    model.gravity.linear = turn @ model.gravity.linear
    return inverse_dynamics(model, X)


def about(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return {"x": x, "y": y}[axis]


def base_tilt(p, step=1e-6):
    high, low = (
        tilted(about("y", h * p["pitch"]) @ about("x", h * p["roll"]))
        for h in (step, -step)
    )
    return (high - low) / (2 * step)


def shifted(zero, step=1e-6):
    moved = [np.hstack([Q + h * np.array([0, zero]), V, A]) for h in (-step, step)]
    low, high = (inverse_dynamics(arm("ZY"), states) for states in moved)
    return -(high - low) / (2 * step)


def turned(p, step=1e-6):
    """Turn about z and x, the two axes across the second joint's y: x comes first."""
    import pinocchio as pin

    torques = []
    for h in (step, -step):
        model = arm("ZY")
        place = model.jointPlacements[2]
        turn = pin.exp3(h * np.array([p["about_x"], 0.0, p["about_y"]]))
        place.rotation = place.rotation @ turn
        torques.append(inverse_dynamics(model, X))
    return (torques[0] - torques[1]) / (2 * step)


def picked_up(p):
    """Inverse dynamics with a ball at the last body, less that without."""
    c = np.array([p["dmcx"], p["dmcy"], p["dmcz"]]) / p["dm"]
    inertia = p["dm"] * (c @ c * np.eye(3) - np.outer(c, c)) + p["d"] * np.eye(3)
    ball = [p["dm"], p["dmcx"], p["dmcy"], p["dmcz"]]
    ball += [inertia[0, 0], inertia[0, 1], inertia[1, 1]]
    ball += [inertia[0, 2], inertia[1, 2], inertia[2, 2]]
    model = arm("ZY")
    with_ball = inverse_dynamics(with_changed_body(model, np.array(ball)), X)
    after = (p["instant"] <= T)[:, None]
    return np.where(after, with_ball - inverse_dynamics(model, X), 0.0)


def elastic(p):
    """Sum of the partial derivatives times the torque and its derivatives."""
    import pinocchio as pin

    model = arm("ZY")
    data, out = model.createData(), np.empty_like(Q)
    load = signals().load[:, 1]
    rate = np.gradient(load, T)
    curve = np.gradient(rate, T)
    for i, row in enumerate(X):
        pin.computeRNEADerivatives(model, data, *row.reshape(3, 2))
        M = np.triu(data.M) + np.triu(data.M, 1).T
        out[i] = data.dtau_dq[:, 1] * load[i] + data.dtau_dv[:, 1] * rate[i]
        out[i] += M[:, 1] * curve[i]
    return -out / p["k"]


def formulas():
    """Effect with coefficients, and its formula written out, p -> torque.

    On the second joint (n,), or on both (n, 2); p has what `parameters` returns and the
    shape.
    """
    q, v, a, w = Q[:, 1], V[:, 1], A[:, 1], V[:, 0]
    sign = np.where(v > 0, 1.0, -1.0)
    load = signals().load[:, 1]
    s = RECORDED["temperature"]
    late = np.interp(T - 0.02, T, load)

    def linkage(p):
        x = q - p["angle"]
        length = np.sqrt(1 + p["ratio"] ** 2 - 2 * p["ratio"] * np.cos(x))
        return (p["Fr"] / length + p["krL"]) * np.sin(x)

    def harmonics(p):
        return (
            p["a"] * np.cos(q)
            + p["b"] * np.sin(q)
            + p["c"] * np.cos(2 * q)
            + p["d"] * np.sin(2 * q)
            + p["e"]
        )

    def lagged(p):
        """Solve T dy/dt = x - y from sample to sample, x straight between them."""
        y = np.empty_like(load)
        y[0] = load[0]
        steps = 400
        for i in range(1, y.size):
            z, h = y[i - 1], 0.01 / steps
            for k in range(steps):
                x = load[i - 1] + (load[i] - load[i - 1]) * (k + 0.5) / steps
                z += h / p["time_constant"] * (x - z)
            y[i] = z
        return y - load

    return {
        "viscous": (effects.Viscous(joint=1), (2.0,), lambda p: p["Fv"] * v),
        "coulomb": (effects.Coulomb(joint=1), (2.0,), lambda p: p["Fc"] * sign),
        "coulomb smooth": (
            effects.Coulomb(joint=1, smoothing=0.3),
            (2.0,),
            lambda p: p["Fc"] * np.tanh(v / p["smoothing"]),
        ),
        "asymmetric_friction": (
            effects.AsymmetricFriction(joint=1),
            (2.0, 3.0),
            lambda p: p["dFc"] * np.abs(sign) + p["dFv"] * np.abs(v),
        ),
        "stribeck": (
            effects.Stribeck(joint=1, vs=0.2, k=2),
            (2.0,),
            lambda p: p["Fs"] * np.exp(-(np.abs(v / p["vs"]) ** p["k"])) * sign,
        ),
        "viscous_quadratic": (
            effects.ViscousQuadratic(joint=1),
            (-2.0,),
            lambda p: p["F2"] * v * np.abs(v),
        ),
        "load_friction": (
            effects.LoadFriction(joint=1),
            (0.1,),
            lambda p: p["mu"] * np.abs(load) * sign,
        ),
        "load_friction smooth": (
            effects.LoadFriction(joint=1, smoothing=0.3),
            (0.1,),
            lambda p: p["mu"] * np.abs(load) * np.tanh(v / p["smoothing"]),
        ),
        "presliding": (
            effects.Presliding(joint=1, displacement=0.05),
            (2.0,),
            lambda p: p["Fp"] * dahl_in_small_steps(q, p["displacement"], 100),
        ),
        "backlash": (
            effects.Backlash(joint=1, width=0.1),
            (20.0, -3.0),
            lambda p: p["k"] * play_sample_by_sample(q, p["width"]) + p["c"],
        ),
        "offset": (effects.Offset(joint=1), (2.0,), lambda p: p["c"] + 0 * q),
        "spring": (
            effects.Spring(joint=1),
            (20.0, -7.0),
            lambda p: p["k"] * (q - p["q0"]),
        ),
        "counterbalance": (
            effects.Counterbalance(joint=1),
            (1.0, -2.0, 3.0, -4.0, 5.0),
            harmonics,
        ),
        "counterbalance linkage": (
            effects.Counterbalance(joint=1, form="linkage", ratio=0.4, angle=0.3),
            (-30.0, 5.0),
            linkage,
        ),
        "ripple": (
            effects.Ripple(joint=1, period=0.3),
            (1.0, -2.0),
            lambda p: p["A"] * np.cos(2 * np.pi * q / p["period"] - p["phase"]),
        ),
        "rotor_inertia": (
            effects.RotorInertia(joint=1),
            (0.3,),
            lambda p: p["Ir"] * a,
        ),
        "coupling": (
            effects.Coupling(joint=1, other=0),
            (1.0, 2.0, 3.0),
            lambda p: p["Fvm"] * w + p["Fcm"] * np.sign(w) + p["Iam"] * A[:, 0],
        ),
        "elastic": (effects.Elastic(joint=1), (1e-4,), elastic),
        "delay": (
            effects.Delay(joint=1, delay=0.02),
            (0.02,),
            lambda p: late - load,
        ),
        "torque_filter": (
            effects.TorqueFilter(joint=1, time_constant=0.05),
            (0.05,),
            lagged,
        ),
        "jerk": (
            effects.Jerk(joint=1),
            (0.2,),
            lambda p: p["J"] * np.gradient(a, T),
        ),
        "signal": (
            effects.Signal(joint=1, signal="temperature", of="viscous", reference=31.0),
            (0.4,),
            lambda p: p["k"] * (s - p["reference"]) * v,
        ),
        "drift": (
            effects.Drift(joint=1, time_constant=3.0),
            (2.0,),
            lambda p: p["D"] * np.exp(-T / p["time_constant"]) * sign,
        ),
        "payload": (
            effects.Payload(joint=1, instant=2.0, centre=(0.1, -0.05, 0.2)),
            (2.0, 0.2, -0.1, 0.4, 0.003),
            picked_up,
        ),
        "base_tilt": (effects.BaseTilt(), (0.03, -0.02), base_tilt),
        "joint_zero": (
            effects.JointZero(joint=1),
            (0.03,),
            lambda p: shifted(p["zero"]),
        ),
        "joint_axis": (effects.JointAxis(joint=1), (0.03, -0.02), turned),
        "torque_gain": (
            effects.TorqueGain(joint=1),
            (1.15,),
            lambda p: (p["gain"] - 1) * load,
        ),
    }


def test_every_formula_is_tried():
    assert {case.split()[0] for case in formulas()} == set(NAMES)


# What small steps, and differences of samples, leave.
ROUGH = {"presliding": 1e-3, "torque_filter": 1e-3, "elastic": 1e-5, "base_tilt": 1e-5}
ROUGH |= {"joint_zero": 1e-5, "joint_axis": 1e-5}


@pytest.mark.parametrize("case", formulas())
def test_the_torque_is_what_the_formula_says(case):
    effect, coef, formula = formulas()[case]
    p = effect.parameters(coef) | effect.shape()
    if effect.in_model:
        p = effect.parameters(coef)
        coef = np.asarray(coef) - effect.nominal
    torque = effect.columns(signals()) @ np.asarray(coef)
    expected = formula(p)
    assert torque.shape == expected.shape
    size = np.abs(expected).max()
    assert size > 0
    assert_allclose(torque, expected, atol=ROUGH.get(effect.name, 1e-9) * size)


def test_the_average_filter_has_the_response_of_the_formula():
    """Of a cosine it leaves exp(-(w T)^2 / 2)."""
    t = 0.001 * np.arange(8000)
    for w in (5.0, 20.0, 60.0):
        load = np.cos(w * t)[:, None]
        smooth = effects.TorqueFilter(kind="smooth", time_constant=0.02)
        states = np.zeros((t.size, 3))
        column = smooth.fit(states).transform(states, t=t, load=load)[:, 0]
        found = load[:, 0] + 0.02 * column
        middle = slice(1000, 7000)
        left = np.exp(-((w * 0.02) ** 2) / 2)
        assert_allclose(found[middle], left * load[middle, 0], atol=1e-3)


# -- what is made when the guide is built ------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_picture_is_of_the_effect(name):
    figure = simulated_effects.figure_of(USES[name])
    chart = figure.charts[0]
    assert {"cloud", "law", "spread", "mean-before"} <= {s.kind for s in chart.shapes}
    assert re.search(r"\[[^\]]+\]$", chart.x_label)
    assert re.search(r"\[N m\]$", chart.y_label)
    torque = simulated_effects.torque_of(USES[name], simulated_effects.scene().motion)
    assert np.abs(torque[:, USES[name].joint]).max() > 0


def test_rivals_are_shares_of_least_squares():
    """One candidate, by a plain regression on everything at once."""
    use = USES["stribeck"]
    at = simulated_effects.scene()
    base = simulated_effects._declared_beside("")
    sizes = at.motion.torque.std(axis=0)
    step = simulated_effects.EVERY
    torque = (simulated_effects.torque_of(use, at.motion) / sizes)[::step].ravel()
    rivals = simulated_effects.rivals_of(use)
    left = torque - base @ np.linalg.lstsq(base, torque, rcond=None)[0]
    assert_allclose(rivals.kept, left @ left / (torque @ torque), rtol=1e-9)
    other = simulated_effects.columns_of(effects.ViscousQuadratic(joint=1), at.motion)
    other = (other / sizes[:, None])[::step].reshape(-1, 1)
    both = np.hstack([base, other])
    rest = torque - both @ np.linalg.lstsq(both, torque, rcond=None)[0]
    share = dict(rivals.others)["viscous_quadratic"]
    assert_allclose(share, 1 - rest @ rest / (left @ left), rtol=1e-6)


CONF = """
import sys
sys.path.insert(0, {folder!r})
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.extlinks",
    "sphinx.ext.mathjax",
    "numpydoc",
    "effect_pages",
]
extlinks = {{"doi": ("https://doi.org/%s", "doi:%s")}}
default_role = "autolink"
"""


@pytest.mark.slow
def test_the_pages_are_built_without_a_warning(tmp_path):
    pytest.importorskip("numpydoc")
    application = pytest.importorskip("sphinx.application")
    source, out = tmp_path / "docs", tmp_path / "html"
    shutil.copytree(DOCS / "effects", source / "effects")
    listed = "".join(f"    effects/{name}\n" for name in NAMES)
    index = f"Guide\n=====\n\n.. effect-index::\n\n.. toctree::\n\n{listed}"
    (source / "index.rst").write_text(f"{index}    evidence\n")
    (source / "evidence.rst").write_text("Evidence\n========\n")
    (source / "conf.py").write_text(CONF.format(folder=str(DOCS / "_ext")))
    warned = io.StringIO()
    sphinx = application.Sphinx(
        source, source, out, tmp_path / "trees", "html", status=None, warning=warned
    )
    sphinx.build()
    assert warned.getvalue() == ""
    assert (out / "_static" / "effects.css").is_file()
    cards = (out / "index.html").read_text(encoding="utf-8")
    assert cards.count("<svg") == len(NAMES)
    for name in NAMES:
        html = (out / "effects" / f"{name}.html").read_text(encoding="utf-8")
        assert html.count("<svg") == 1
        assert "effects.css" in html

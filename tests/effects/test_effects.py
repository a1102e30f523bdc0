"""Columns of the effects against closed forms and sample-by-sample loops."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import Motion, Rest, elements, play
from tests.effects._arms import (
    Derivatives,
    arm,
    bristles_sample_by_sample,
    inverse_dynamics,
    last_body_regressor,
    motion,
    play_sample_by_sample,
    stops_sample_by_sample,
    with_changed_body,
)

# The guide lists the names in this order; tests/test_docs.py compares.
NAMES = effects.available()
# Effects whose columns need the rigid-body dynamics.
GEOMETRY = ("base_tilt", "joint_zero", "joint_axis")
BODIES = ("elastic", "payload", *GEOMETRY)
# Two joints: q1 q2 v1 v2 a1 a2
T, X = motion(2, duration=6.0, seed=3)
Q, V, A = np.split(X, 3, axis=1)
LOAD = np.column_stack([3 * np.sin(2 * T) - 1, 2 * np.cos(3 * T)])
# Signals: a temperature that rises and falls, and a tool that is attached once.
RECORDED = {"temperature": 30 + 8 * np.sin(0.9 * T), "tool": 1.0 * (T > 3)}


def library_effect(name, joint=0):
    (effect,) = effects.resolve(name)
    if name == "payload":
        joint = 1
    if name == "signal":
        effect.set_params(signal="temperature")
    return effect.set_params(joint=joint)


def signals(prismatic=(False, False), scale=1.0, **changed):
    """Return the motion of two joints with all signals."""
    model = arm("ZY")
    return Motion(
        **{
            "q": scale * Q,
            "v": scale * V,
            "a": scale * A,
            "t": T,
            "load": LOAD,
            "prismatic": np.array(prismatic),
            "rigid": lambda q, v, a: inverse_dynamics(model, np.hstack([q, v, a])),
            "end_bodies": {1: lambda: last_body_regressor(model, X)},
            "derivatives": Derivatives(model, X),
            "bandwidth": 5.0,
            "signals": RECORDED,
            **changed,
        }
    )


def transform(effect, **keywords):
    keywords = {"t": T, "load": LOAD, "signals": RECORDED, **keywords}
    return effect.fit(X).transform(X, **keywords)


# -- the library


@pytest.mark.parametrize("name", NAMES)
def test_coefficients_units_and_columns_agree(name):
    effect = library_effect(name)
    k = len(effect.coefficients)
    assert k == len(effect.units) == len(set(effect.coefficients))
    assert all(len(pair) == 2 for pair in effect.units)
    columns = effect.columns(signals())
    joints = (2,) * isinstance(effect, effects.OnAllJoints)
    assert columns.shape == (T.size, *joints, k)
    assert np.isfinite(columns).all()
    names = [f"joint {effect.joint + 1}:{name}:{c}" for c in effect.coefficients]
    assert list(effect.get_feature_names_out()) == names
    assert set(effect.continuous) <= set(effect.get_params())
    assert effect.record


def applies_to_prismatic(name):
    """Return whether an effect applies to a prismatic joint."""
    return "prismatic" not in library_effect(name).applies(signals((True, True)))


@pytest.mark.parametrize("prismatic", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_parameters_have_units(name, prismatic):
    effect = library_effect(name)
    values = effect.parameters(np.linspace(0.5, 1.0, len(effect.coefficients)))
    if prismatic and not applies_to_prismatic(name):
        return
    units = effect.parameter_units(prismatic)
    assert all(isinstance(value, float) for value in values.values())
    assert set(values) | set(effect.continuous) <= set(units)
    # Angles stay angles on a prismatic joint.
    angles = {"angle", "phase", "roll", "pitch", "about_x", "about_y"}
    assert "rad" not in " ".join(
        unit for key, unit in units.items() if prismatic and key not in angles
    )


@pytest.mark.parametrize(
    ("requested", "message"),
    [
        ("stiction", "Unknown effect 'stiction'; expected one of viscous, coulomb"),
        (["coulomb", "all"], "Unknown effect 'all'"),
        (["coulomb", effects.Coulomb(joint=1)], "effects names coulomb twice"),
        ([3.0], r"names of the library, classes or instances of Effect; got 3\.0"),
        ([int], "classes or instances of Effect"),
    ],
)
def test_unknown_effects_are_refused(requested, message):
    with pytest.raises(ValueError, match=message):
        effects.resolve(requested)


# -- columns


def distance(angle, r):
    """Return the distance of the point (r, 0), rotated by an angle, from (1, 0)."""
    return np.hypot(r * np.cos(angle) - 1, r * np.sin(angle))


def lever_arm(angle, r):
    """Return the signed distance of the line through both points from the axis."""
    x, y = r * np.cos(angle), r * np.sin(angle)
    # cross product of a point of the line with its direction
    return (x * 0 - y * 1) / -np.hypot(x - 1, y)


def closed_forms():
    """Return parameters of effects on the second joint, and their columns by hand."""
    q, v, a, load = Q[:, 1], V[:, 1], A[:, 1], LOAD[:, 1]
    w = V[:, 0]
    one = np.ones_like(q)
    sign = np.where(v > 0, 1.0, np.where(v < 0, -1.0, 0.0))
    lagged = np.array([np.interp(max(s - 0.034, 0.0), T, load) for s in T])
    return {
        "viscous": ({}, [v]),
        "coulomb": ({}, [sign]),
        "asymmetric_friction": ({}, [one, v * sign]),
        "stribeck": ({"vs": 0.3}, [sign * np.exp(-v * sign / 0.3)]),
        "stribeck square": ({"vs": 0.3, "k": 2}, [sign * np.exp(-(v**2) / 0.09)]),
        "viscous_quadratic": ({}, [sign * v**2]),
        "load_friction": ({}, [np.sqrt(load**2) * sign]),
        "gear_loss": (
            {},
            [np.where(load * v > 0, load, 0.0), np.where(load * v < 0, -load, 0.0)],
        ),
        "maxwell_slip": (
            {"displacements": (0.02, 0.3), "loaded": (0.1,), "falling": (0.05,)},
            [
                stops_sample_by_sample(q, 0.02),
                stops_sample_by_sample(q, 0.3),
                np.sqrt(load**2) * stops_sample_by_sample(q, 0.1),
                stops_sample_by_sample(q, 0.05, 1 + np.exp(-(v**2) / 0.01)),
            ],
        ),
        "maxwell_slip bristle": (
            {"displacements": (0.02,), "falling": (1e-4, 0.05), "element": "bristle"},
            [
                bristles_sample_by_sample(q, 0.02, one),
                bristles_sample_by_sample(q, 1e-4, 1 + np.exp(-(v**2) / 0.01)),
                bristles_sample_by_sample(q, 0.05, 1 + np.exp(-(v**2) / 0.01)),
            ],
        ),
        "backlash": ({"width": 0.07}, [play_sample_by_sample(q, 0.07), one]),
        "offset": ({}, [one]),
        "spring": ({}, [q, one]),
        "counterbalance": (
            {},
            [
                np.cos(q),
                np.sin(q),
                np.cos(q) ** 2 - np.sin(q) ** 2,
                2 * np.sin(q) * np.cos(q),
                one,
            ],
        ),
        "counterbalance linkage": (
            {"form": "linkage", "ratio": 0.4, "angle": 0.3},
            [
                # Torque of a force of 1 N, and of a spring of 1 N/m
                lever_arm(q - 0.3, 0.4) / 0.4,
                lever_arm(q - 0.3, 0.4) * distance(q - 0.3, 0.4) / 0.4,
            ],
        ),
        "ripple": (
            {"period": 0.4},
            [np.exp(2j * np.pi * q / 0.4).real, np.exp(2j * np.pi * q / 0.4).imag],
        ),
        "friction_by_position": (
            {"period": 1.7},
            [sign * np.cos(2 * np.pi * q / 1.7), sign * np.sin(2 * np.pi * q / 1.7)],
        ),
        "rotor_inertia": ({}, [a]),
        "coupling": ({"other": 0}, [w, np.sign(w), A[:, 0]]),
        "coupling sum": ({"other": 0, "ratio": 1.0}, [w, np.sign(w + v), A[:, 0]]),
        "coupling tendon": (
            {"other": 0, "ratio": -0.7},
            [w, np.sign(w - 0.7 * v), A[:, 0]],
        ),
        "delay": ({"delay": 0.034}, [(lagged - load) / 0.034]),
        "torque_gain": ({"gain": 1.6}, [load / 1.6]),
        "jerk": ({}, [np.r_[a[1] - a[0], (a[2:] - a[:-2]) / 2, a[-1] - a[-2]] / 0.01]),
        "signal": ({"reference": 25.0}, [sign * (5 + 8 * np.sin(0.9 * T))]),
        "signal offset": (
            {"signal": "tool", "of": "offset"},
            [np.r_[np.zeros(301), np.ones(T.size - 301)]],
        ),
        "signal viscous": (
            {"of": "viscous", "reference": 30.0},
            [v * 8 * np.sin(0.9 * T)],
        ),
        "drift": ({"time_constant": 7.0}, [sign * np.exp(-T / 7)]),
        "drift offset": ({"of": "offset", "time_constant": 7.0}, [np.exp(-T / 7)]),
        "drift viscous": (
            {"of": "viscous", "time_constant": 7.0},
            [v * np.exp(-T / 7)],
        ),
    }


@pytest.mark.parametrize("case", closed_forms())
def test_columns_match_closed_forms(case):
    parameters, expected = closed_forms()[case]
    effect = library_effect(case.split()[0], joint=1).set_params(**parameters)
    assert_allclose(transform(effect), np.column_stack(expected), rtol=1e-9, atol=1e-12)


walks = st.lists(st.integers(-40, 40), min_size=2, max_size=40).map(
    lambda steps: np.cumsum(steps) / 32.0
)


@settings(deadline=None, max_examples=25)
@given(q=walks, displacement=st.sampled_from([0.03125, 0.25, 1.0, 4.0]))
def test_stop_operators_on_random_walks(q, displacement):
    z = elements(q, (displacement, 2 * displacement))
    assert_allclose(z[:, 0], stops_sample_by_sample(q, displacement), atol=1e-12)
    assert_allclose(z[:, 1], stops_sample_by_sample(q, 2 * displacement), atol=1e-12)
    assert_array_equal(elements(-q, (displacement,))[:, 0], -z[:, 0])


@settings(deadline=None, max_examples=25)
@given(q=walks, creeps=st.booleans())
def test_elements_continue_from_previous_positions(q, creeps):
    half, d = len(q) // 2, (0.03125, 0.25, 1.0)
    whole = elements(q, d, creeps=creeps)
    later = elements(q[half:], d, creeps=creeps, before=q[:half])
    assert_allclose(later, whole[half:], atol=1e-12)


def test_virgin_curve_is_the_torque_of_a_motion_from_rest():
    effect = effects.MaxwellSlip(displacements=(0.01, 0.04))
    coef, x = [2.0, 1.0], np.linspace(0.0, 0.06, 13)
    states = np.column_stack([x, np.ones((13, 2))])
    curve = effect.fit_transform(states) @ coef
    assert_allclose(effect.virgin_curve(coef, x), curve)
    parameters = effect.parameters(coef)
    assert parameters["Fc"] == 3.0
    assert_allclose(np.interp(parameters["half"], x, curve), 1.5)


def test_zero_displacements_reduce_to_the_contained_effects():
    small = dict.fromkeys(("displacements", "loaded", "falling"), (0.0,))
    bank = effects.MaxwellSlip(0, vs=0.3, **small)
    assert bank.contains == ("coulomb", "load_friction")
    plain = effects.Coulomb(0), effects.LoadFriction(0)
    plain += (effects.Stribeck(0, vs=0.3, k=2),)
    moved = signals()
    moving = np.diff(moved.q[:, 0], prepend=moved.q[0, 0]) * V[:, 0] > 0
    coulomb, load, stribeck = (e.columns(moved)[moving] for e in plain)
    expected = np.hstack([coulomb, load, coulomb + stribeck])
    assert_allclose(bank.columns(moved)[moving], expected, atol=1e-12)
    assert effects.MaxwellSlip(0).contains == ("coulomb",)


def test_position_noise_at_rest_does_not_move_elements():
    q = np.r_[0.0, 0.1, 0.2 + 1e-4 * np.sin(np.arange(40))]
    zeros = np.zeros((q.size, 1))
    rest = Rest(
        speed=zeros[0], time=zeros[0], noise=zeros[0], play=np.full((2, 1), 1e-4)
    )
    motion = Motion(q=q[:, None], v=zeros, a=zeros, rest=rest)
    z = effects.MaxwellSlip(0, displacements=(0.0, 1e-3)).columns(motion)
    assert_array_equal(z[1:], 1.0)


def test_only_selects_columns_of_the_bank():
    bank = effects.MaxwellSlip(
        displacements=(0.01, 0.04), loaded=(0.1,), falling=(0.02, 0.03), vs=0.3
    )
    mask = np.array([False, True, True, False, True])
    assert_array_equal(transform(bank.only(mask)), transform(bank)[:, mask])
    assert bank.only(mask).coefficients == ("F1", "mu1", "S1")


@pytest.mark.parametrize("values", [(), (0.1, -1.0), (np.nan,)])
def test_invalid_displacements_are_refused(values):
    with pytest.raises(ValueError, match="displacements"):
        transform(effects.MaxwellSlip(displacements=values))


def test_an_outlier_in_the_first_row_does_not_turn_a_relaxed_element():
    q = 1e-5 * np.repeat([0.0, 1.4, 5.0, 3.0, 1.0], [1, 50, 50, 1, 1])
    z = elements(q, [0.0], widths=(2e-5, 0.0))[:, 0]
    assert z.tolist() == [0.0] * 51 + [1.0] * 51 + [-1.0]


@settings(deadline=None, max_examples=40)
@given(q=walks, width=st.sampled_from([0.0, 0.125, 1.0, 3.0]))
def test_play_operator_on_random_walks(q, width):
    p = play(q, width)
    assert_allclose(p, play_sample_by_sample(q, width), atol=1e-12)
    assert np.all(np.abs(p - q) <= 0.5 * width + 1e-12)
    # Applying a play twice is a play of twice the width.
    assert_allclose(play(p, width), play(q, 2 * width), atol=1e-12)


def test_elastic_columns_are_the_derivatives_by_the_compliance():
    import pinocchio as pin

    model = arm("ZYX")
    t, states = motion(3, duration=4.0, dt=0.005, seed=8)
    w = np.array([2.0, 3.0, 5.0])
    load = 4 * np.sin(np.outer(t, w))
    j = 1
    moved = Motion(
        q=states[:, :3],
        v=states[:, 3:6],
        a=states[:, 6:],
        t=t,
        load=load,
        rigid=lambda q, v, a: inverse_dynamics(model, np.hstack([q, v, a])),
    )
    columns = effects.Elastic(joint=j).columns(moved)
    assert columns.shape == (t.size, 3, 1)
    rate = 4 * w[j] * np.cos(w[j] * t)
    curve = -(w[j] ** 2) * load[:, j]
    data = model.createData()
    inside = np.arange(10, t.size - 10, 7)
    expected = []
    for i in inside:
        pin.computeRNEADerivatives(model, data, *states[i].reshape(3, 3))
        M = data.M + np.triu(data.M, 1).T - np.tril(data.M, -1)
        expected.append(
            -data.dtau_dq[:, j] * load[i, j]
            - data.dtau_dv[:, j] * rate[i]
            - M[:, j] * curve[i]
        )
    size = np.abs(expected).max()
    assert_allclose(columns[inside, :, 0], expected, atol=2e-3 * size)


def test_payload_columns_are_the_torque_of_the_added_body():
    model = arm("ZY")
    delta = np.r_[0.7, 0.02, -0.05, 0.1, np.zeros(6)]
    heavier = with_changed_body(model, delta)
    added = inverse_dynamics(heavier, X) - inverse_dynamics(model, X)
    effect = effects.Payload(joint=1, instant=2.5)
    columns = effect.columns(signals())
    coef = np.r_[delta[:4], 0.0]
    assert_allclose(columns @ coef, added * (T >= 2.5)[:, None], atol=1e-9)
    effect.until = 3.5
    carried = (T >= 2.5) & (T < 3.5)
    assert_allclose(
        effect.columns(signals()) @ coef, added * carried[:, None], atol=1e-9
    )


def test_payload_is_a_sphere_around_its_centre_of_mass():
    """The columns are exact if linearised at the payload's centre."""
    import pinocchio as pin

    model = arm("ZY")
    sphere = pin.SE3(np.eye(3), np.array([0.08, -0.05, 0.11])).act(
        pin.Inertia.FromSphere(0.7, 0.06)
    )
    delta = sphere.toDynamicParameters()
    heavier = with_changed_body(model, delta)
    added = inverse_dynamics(heavier, X) - inverse_dynamics(model, X)
    coef = np.r_[delta[:4], 0.4 * 0.7 * 0.06**2]
    effect = effects.Payload(joint=1, instant=-1.0)
    linearised = effect.linearised_at(coef)
    assert_allclose(linearised.centre, [0.08, -0.05, 0.11])
    assert_allclose(linearised.columns(signals()) @ coef, added, atol=1e-9)
    # Accurate to first order near the centre.
    rough = np.abs(effect.columns(signals()) @ coef - added).max()
    near = effects.Payload(joint=1, instant=-1.0, centre=(0.081, -0.05, 0.11))
    assert np.abs(near.columns(signals()) @ coef - added).max() < 1e-3 * rough
    # The centre of a payload without mass is the origin.
    for mass in (0.0, 0.01):
        massless = effect.linearised_at(np.r_[mass, 0.1, 0.0, 0.0, 0.0])
        assert massless.centre == (0.0, 0.0, 0.0)


# -- recordings


@pytest.mark.parametrize("name", [n for n in NAMES if n not in BODIES])
def test_memory_is_reset_between_recordings(name):
    effect = library_effect(name)
    memory = name in ("delay", "torque_filter", "jerk", "maxwell_slip", "backlash")
    if name == "maxwell_slip":
        effect.set_params(displacements=(0.3,))
    elif memory and effect.continuous:
        (shape,) = effect.continuous
        effect.set_params(**{shape: 0.2})
    second = np.arange(T.size) >= T.size // 2
    together = transform(effect, groups=second)
    for part in (~second, second):
        signals = {key: values[part] for key, values in RECORDED.items()}
        apart = effect.transform(X[part], t=T[part], load=LOAD[part], signals=signals)
        assert_array_equal(together[part], apart)
    assert np.array_equal(together, transform(effect)) != memory


# -- shapes


SCALED = [n for n in NAMES if n not in BODIES and applies_to_prismatic(n)]


@pytest.mark.parametrize("name", SCALED)
def test_columns_are_the_same_in_millimetres(name):
    """Shapes scale with the unit of a prismatic joint; columns differ by a factor."""
    metres = signals((True, True))
    millimetres = signals((True, True), scale=1000.0)
    effect = library_effect(name)
    shapes, shapes_mm = effect.shapes(metres), effect.shapes(millimetres)
    assert len(shapes) == len(shapes_mm) > 0
    for shape, shape_mm in zip(shapes, shapes_mm):
        a = clone(effect).set_params(**shape).columns(metres)
        b = clone(effect).set_params(**shape_mm).columns(millimetres)
        a, b = (x / np.sqrt(np.mean(x**2, axis=0)) for x in (a, b))
        assert_allclose(a, b, atol=1e-6)


# -- parameters


def test_named_parameters():
    assert effects.Spring().parameters([4.0, -2.0]) == {"k": 4.0, "q0": 0.5}
    assert np.isnan(effects.Spring().parameters([0.0, 1.0])["q0"])
    coef = [3 * np.cos(0.7), 3 * np.sin(0.7)]
    ripple = effects.Ripple(period=0.3).parameters(coef)
    assert ripple["A"] == pytest.approx(3.0)
    assert ripple["phase"] == pytest.approx(0.7)
    q = np.linspace(-1, 1, 50)
    columns = effects.Ripple(period=0.3).fit_transform(np.c_[q, q, q])
    expected = 3 * np.cos(2 * np.pi * q / 0.3 - 0.7)
    assert_allclose(columns @ coef, expected, atol=1e-12)
    assert effects.Elastic().parameters([0.0])["k"] == np.inf
    assert effects.Delay().parameters([0.004]) == {"delay": 0.004}
    assert "late" not in effects.Delay(delay=-0.004).files.mjcf
    assert effects.Drift(of="viscous").parameter_units()["D"] == "N m s/rad"
    assert effects.Drift(of="viscous").parameter_units(True)["D"] == "N s/m"
    assert effects.Drift().parameter_units()["D"] == "N m"


def test_keys_depend_on_use_and_not_on_shape():
    assert effects.Stribeck(vs=0.1, k=1).key() == effects.Stribeck(vs=0.2, k=2).key()
    assert effects.Drift(of="offset").key() != effects.Drift(of="coulomb").key()
    cold, warm = (effects.Signal(signal="T", reference=x) for x in (0.0, 30.0))
    assert cold.key() == warm.key()
    assert cold.key() != effects.Signal(signal="U").key()
    assert cold.key() != effects.Signal(signal="T", of="viscous").key()
    assert effects.Coupling(other=1).key() != effects.Coupling(other=2).key()
    assert effects.Coulomb(0).key() != effects.Coulomb(1).key()
    short, long = (effects.FrictionByPosition(0, period=p) for p in (0.1, 2.0))
    assert short.key() == long.key()
    assert long.key() in short.excludes()
    # Ripples of one joint must have clearly different periods.
    first, near, far = (effects.Ripple(period=x) for x in (0.1, 0.12, 0.3))
    assert near.key() in first.excludes()
    assert far.key() not in first.excludes()


# -- missing signals


@pytest.mark.parametrize("name", [e.name for e in effects.resolve("all") if e.needs])
def test_missing_signals_are_named(name):
    effect = library_effect(name)
    for need in effect.needs:
        given = {"t": T, "load": LOAD, "signals": RECORDED}
        given.pop({"time": "t"}.get(need, need), None)
        with pytest.raises(ValueError, match=f"{name} on joint . *: needs"):
            effect.fit(X).transform(X, **given)


@pytest.mark.parametrize("name", BODIES)
def test_effects_of_the_bodies_need_rigid_body_dynamics(name):
    with pytest.raises(ValueError, match="needs the rigid-body dynamics"):
        transform(library_effect(name))


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"t": T[:-1]}, r"t must have shape \(600,\)"),
        ({"load": LOAD[:, :1]}, r"load must have shape \(600, 2\)"),
        (
            {"groups": np.zeros(5)},
            r"groups must hold one label per row, shape \(600,\)",
        ),
        ({"groups": np.full(600, np.nan)}, "groups must label every row; got nan"),
        ({"load": LOAD * np.nan}, "NaN"),
    ],
)
def test_invalid_signals_are_refused(inputs, message):
    with pytest.raises(ValueError, match=message):
        transform(effects.LoadFriction(), **inputs)


@given(
    ratio=st.floats(0.05, 0.95), angle=st.floats(-3.0, 3.0), rest=st.floats(0.0, 1.5)
)
@settings(deadline=None, max_examples=25)
def test_linkage_torque_is_the_derivative_of_the_spring_energy(ratio, angle, rest):
    """The energy is that of a coil spring of free length `rest`."""
    q = np.linspace(-1.0, 1.0, 2001)
    energy = 0.5 * 7.0 * (distance(q - angle, ratio) - rest) ** 2
    effect = effects.Counterbalance(form="linkage", ratio=ratio, angle=angle)
    coef = [-7.0 * rest * ratio, 7.0 * ratio]
    torque = effect.fit_transform(np.c_[q, q, q]) @ coef
    assert_allclose(torque[1:-1], np.gradient(energy, q)[1:-1], atol=2e-3)


# -- invalid settings


@pytest.mark.parametrize(
    "effect",
    [
        effects.Stribeck(vs=0.0),
        effects.Ripple(period=0.0),
        effects.Counterbalance(form="linkage", ratio=0.0),
        effects.Delay(delay=0.0),
        effects.TorqueFilter(time_constant=0.0),
        effects.Drift(time_constant=0.0),
    ],
)
def test_shape_parameters_of_zero_are_refused(effect):
    with pytest.raises(ValueError, match=effect.continuous[0]):
        transform(effect)


@pytest.mark.parametrize("constant", [0.5, 1e5])
def test_drift_over_a_recording_has_zero_mean_and_unit_decrease(constant):
    t = np.linspace(3.0, 8.0, 100_001)
    motion = Motion(q=t[:, None], v=t[:, None], a=t[:, None], t=t)
    shape = {"time_constant": constant, "begin": 3.0, "end": 8.0}
    (column,) = effects.Drift(of="offset", **shape).columns(motion).T
    assert column[0] - column[-1] == pytest.approx(1.0)
    assert np.trapezoid(column, t) == pytest.approx(0.0, abs=1e-7)
    curve = np.exp(-t / constant) if constant < 1 else -t
    assert abs(np.corrcoef(column, curve)[0, 1]) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="below end"):
        effects.Drift(begin=1.0, end=1.0).fit(np.zeros((1, 3)))


# -- outside the time of a fit


@pytest.mark.parametrize("of", ["coulomb", "offset", "viscous"])
def test_drift_is_constant_before_the_fitted_time(of):
    drift = effects.Drift(of=of, time_constant=2.0)
    whole = signals(t=T - 100.0)
    fitted = signals(t=T - 100.0, since=-97.0)
    expected = drift.columns(signals(t=np.maximum(T - 100.0, -97.0)))
    assert_array_equal(drift.columns(fitted), expected)
    later = T - 100.0 >= -97.0
    assert_array_equal(drift.columns(fitted)[later], drift.columns(whole)[later])

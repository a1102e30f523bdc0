"""EffectDiscovery on small recordings with known missing effects."""

import pickle
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, effects
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis.explain import split_in_time
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.robot import FitOptions
from tests._quick import one_in
from tests.diagnosis._recordings import SPRINGY, named, record
from tests.diagnosis.report._pages import text_of
from tests.diagnosis.search._searches import coulomb, spring
from tests.effects._arms import play_sample_by_sample
from tests.effects._faults import Cubic
from tests.robot import test_drives as drives

ARM = SPRINGY.parts[0]
GOOD = SPRINGY.torque
PLAIN = ["coulomb", "offset", "spring"]


def quadratic(size):
    return lambda r: size * r.v[:, 1] * np.abs(r.v[:, 1])


def lugre(r, joint=1, force=1.2, displacement=0.02):
    """Integrate the LuGre bristle model with constant friction force."""
    fine = np.linspace(r.t[0], r.t[-1], 40 * (r.t.size - 1) + 1)
    speed, z = np.interp(fine, r.t, r.v[:, joint]), np.zeros(fine.size)
    half = 0.5 * (fine[1] - fine[0])
    for i, v in enumerate(speed[:-1]):
        middle = z[i] + half * (v - abs(v) * z[i] / displacement)
        z[i + 1] = z[i] + 2 * half * (v - abs(v) * middle / displacement)
    return force / displacement * z[::40]


# -- the right effect, on the right joint


@pytest.mark.parametrize("encoder", one_in(2, [3e-4, 3e-3]))
def test_encoder_noise_causes_no_false_positives(encoder):
    """Encoder noise up to 150 times that of the other recordings."""
    noisy = record("ZY", seed=0, duration=30.0, encoder=encoder)
    library = ["load_friction", "viscous_quadratic", "jerk", "elastic", *PLAIN]
    assert noisy.discover(noisy.torque(), library).effects_ == ()
    with_spring = noisy.torque(joint_1=spring(4.0, 1.0))
    assert named(noisy.discover(with_spring, library)) == [("spring", 0)]


def torque_and_truth(name):
    """Return an independent implementation by joint, and the true parameters."""
    return {
        "spring": ({"joint_1": spring(4.0, -1.0)}, {"k": 4.0, "q0": 0.25}),
        "ripple": (
            {"joint_1": lambda r: 0.6 * np.sin(2 * np.pi * r.q[:, 0] / 0.35)},
            {"A": 0.6, "period": 0.35, "phase": np.pi / 2},
        ),
        "stribeck": (
            {
                "joint_2": lambda r: (
                    1.5 * np.sign(r.v[:, 1]) / np.exp(np.abs(r.v[:, 1]) / 0.4)
                )
            },
            {"Fs": 1.5, "vs": 0.4},
        ),
        "maxwell_slip": ({"joint_2": lugre}, {"Fc": 1.2, "half": 0.0139}),
        "backlash": (
            {"joint_1": lambda r: 20 * play_sample_by_sample(r.q[:, 0], 0.2)},
            {"k": 20.0, "width": 0.2},
        ),
        "drift": (
            {
                "joint_2": lambda r: (
                    2.0 * np.sign(r.v[:, 1]) * np.exp2(-r.t / (8 * np.log(2)))
                )
            },
            {"D": 2.0, "time_constant": 8.0},
        ),
        "load_friction": (
            {"joint_2": lambda r: 0.15 * np.abs(r.load[:, 1]) * np.sign(r.v[:, 1])},
            {"mu": 0.15},
        ),
    }[name]


@pytest.mark.parametrize(
    ("name", "rivals"),
    [
        ("spring", ["coulomb", "offset", "ripple", "backlash"]),
        ("ripple", ["offset", "spring", "coulomb"]),
        pytest.param("stribeck", ["coulomb", "spring"], marks=pytest.mark.slow),
        pytest.param("maxwell_slip", ["coulomb", "stribeck"], marks=pytest.mark.slow),
        ("backlash", ["coulomb", "spring", "offset"]),
        pytest.param("drift", ["coulomb", "offset"], marks=pytest.mark.slow),
        ("load_friction", ["coulomb", "stribeck"]),
    ],
)
def test_an_effect_is_found_with_joint_and_parameters(name, rivals):
    torques, truth = torque_and_truth(name)
    torque = ARM.torque(**torques)
    loop = ARM.discover(torque, [*rivals, name])
    joint = int(next(iter(torques))[-1]) - 1
    assert (name, joint) in named(loop)
    (effect,) = [e for e in loop.effects_ if (e.name, e.joint) == (name, joint)]
    for key, value in truth.items():
        assert effect.parameters[key] == pytest.approx(value, rel=0.15), key
        assert effect.units[key] is not None
    assert loop.error_after_[joint] < 0.5 * loop.error_before_[joint]
    assert {e.joint for e in loop.effects_} == {joint}
    assert len(loop.effects_) == 1
    assert effect.rivals == ()


def test_two_effects_on_two_joints():
    torque = ARM.torque(joint_2=quadratic(0.4), joint_1=spring(4.0, 1.0))
    loop = ARM.discover(torque, [*PLAIN, "viscous_quadratic", "ripple"])
    assert named(loop) == [("spring", 0), ("viscous_quadratic", 1)]
    by_name = {e.name: e.parameters for e in loop.effects_}
    assert by_name["viscous_quadratic"]["F2"] == pytest.approx(0.4, rel=0.05)
    assert by_name["spring"]["k"] == pytest.approx(4.0, rel=0.05)
    assert np.all(loop.error_after_ < 0.5 * loop.error_before_)
    assert loop.unexplained_ == ()


def test_no_false_positives(complete):
    assert complete.effects_ == complete.unexplained_ == ()
    assert complete.validation_model_ is complete.baseline_
    assert_array_equal(complete.error_after_, complete.error_plain_)
    errors = complete.report_.outcome.errors
    low, high = np.transpose([x.intervals["after"] for x in errors])
    assert np.all((low < complete.error_after_) & (complete.error_after_ < high))
    assert "cost" not in str(complete.report_)


def test_units_of_prismatic_joints():
    recording = record("zY", seed=0, size=0.4)
    torque = recording.torque(joint_1=spring(20.0))
    loop = recording.discover(torque, ["viscous_quadratic", "spring", "ripple"])
    assert named(loop) == [("spring", 0)]
    (effect,) = loop.effects_
    assert effect.parameters["k"] == pytest.approx(20.0, rel=0.05)
    assert effect.units["k"] == "N/m"
    assert effect.joint_name == "joint_1"


# -- attributes


def test_attributes_of_discovered_effects(springy):
    (effect,) = springy.effects_
    assert (effect.name, effect.joint, effect.joint_name) == ("spring", 0, "joint_1")
    assert effect.units == {"k": "N m/rad", "q0": "rad"}
    assert set(effect.intervals) == {"k", "q0"}
    for key, (low, high) in effect.intervals.items():
        assert low < effect.parameters[key] < high
    low, high = effect.intervals["k"]
    assert low < 4.05
    assert high > 3.95
    assert effect.probability > 0.95
    assert effect.log_odds > np.log(19.0)
    assert effect.warning == ""
    assert effect.effect.name == "spring"
    assert effect.effect.joint == 0
    at = springy.baseline_.theta_.size
    coef = springy.identifier_.theta_[at:]
    assert effect.parameters == pytest.approx(effect.effect.parameters(coef))
    assert springy.error_before_.shape == springy.error_after_.shape == (2,)
    assert "spring" in text_of(springy.report_)


def split_of(robot, position, torque=None, share=0.25):
    """Return a recording and its split into searched and held-out rows."""
    names = [f"joint_{k}" for k in range(position.shape[1])]
    torque = position if torque is None else torque
    recording = take_arrays(position, torque, None, dt=robot.dt, joint_names=names)
    return recording, split_in_time(robot, recording, share)


def held_out(split):
    """Return the rows of all held-out segments."""
    return np.r_[split.stretches]


def test_errors_are_computed_on_held_out_data(springy):
    recording, split = split_of(ARM.robot(), ARM.position, GOOD)
    search = split.searched(recording)
    refitted = ARM.robot().fit(search.q, search.tau, groups=search.groups)
    assert_allclose(refitted.theta_, springy.declared_.theta_, rtol=1e-9)
    guard = springy.report_.outcome.provenance["settings"]["guard_seconds"]
    test = split.with_guard(round(guard / ARM.robot().dt))
    assert 0 < held_out(test).size <= held_out(split).size
    test = test.held_out(recording)
    weight = []
    for model, error in (
        (springy.declared_, springy.error_before_),
        (springy.validation_model_, springy.error_after_),
    ):
        residuals = model.residuals(test.q, test.tau, groups=test.groups)
        assert_allclose(residuals.rms(), error * springy.torque_std_, rtol=1e-9)
        weight.append(residuals.weight)
    # The joints move most of the time.
    total = weight[0].shape[0] * np.diff(residuals.index[:2])[0] * ARM.robot().dt
    seconds = springy.report_.outcome.column("seconds")
    assert np.all((seconds > 0.7 * total) & (seconds <= total))


def test_torque_std_uses_the_whole_recording(springy):
    """A quiet held-out part must not make a small error large."""
    whole = springy.declared_.residuals(ARM.position, GOOD)
    moving = np.array([x[w > 0].std() for x, w in zip(whole.torque.T, whole.weight.T)])
    assert_allclose(springy.torque_std_, moving, rtol=0.1)


def test_the_identifier_is_fitted_to_all_data(springy):
    (effect,) = springy.effects_
    refitted = ARM.robot(
        effects=(effect.effect,),
        friction=springy.baseline_.features_.friction_,
        cutoff=springy.validation_model_.cutoff_,
        options=FitOptions(standstill=springy.validation_model_.standstill_),
    ).fit(ARM.position, GOOD)
    assert_allclose(refitted.theta_, springy.identifier_.theta_, rtol=1e-9)
    assert not np.allclose(
        springy.validation_model_.theta_, springy.identifier_.theta_, rtol=1e-6
    )
    all_, part = springy.identifier_.theta_std_, springy.validation_model_.theta_std_
    finite = np.isfinite(part)
    assert finite.any()
    assert np.all(all_[finite] < 1.2 * part[finite])
    assert "fitted to all data" in text_of(springy.report_)


def test_prediction_uses_the_completed_model(springy):
    predicted = springy.predict(ARM.position)
    assert_array_equal(predicted, springy.identifier_.predict(ARM.position))
    truth = ARM.load + [0.8, 0.5] * ARM.v
    truth[:, 0] += 4 * ARM.q[:, 0] + 1
    error = (predicted - truth)[50:-50]
    assert np.all(error.std(axis=0) < 0.02 * truth.std(axis=0))
    assert springy.score(ARM.position, GOOD) > 0.99


# -- the held-out part


def test_the_search_ignores_held_out_data(springy):
    rows = held_out(split_of(ARM.robot(), ARM.position)[1])
    other = GOOD.copy()
    other[rows] += 3 * np.random.default_rng(0).normal(size=(rows.size, 2))
    loop = SPRINGY.search(other)
    assert named(loop) == named(springy)
    assert_array_equal(loop.validation_model_.theta_, springy.validation_model_.theta_)
    assert_array_equal(loop.declared_.theta_, springy.declared_.theta_)
    assert [e.evidence for e in loop.effects_] == [e.evidence for e in springy.effects_]
    assert np.all(loop.error_after_ > 2 * springy.error_after_)


# -- recordings


def test_effects_of_time_use_the_time_stamps():
    added, _ = torque_and_truth("drift")
    torque = ARM.torque(**added)
    loop = ARM.discover(torque, ["coulomb", "drift"], t=ARM.t + 4.0)
    assert named(loop) == [("drift", 1)]
    parameters = loop.effects_[0].parameters
    assert parameters["time_constant"] == pytest.approx(8.0, rel=0.15)
    fades = np.exp(-np.array([parameters["begin"], parameters["end"]]) / 8.0)
    assert parameters["D"] == pytest.approx(
        2.0 * np.exp(4 / 8) * -np.diff(fades)[0], 0.2
    )


# -- searched effects


def test_max_effects_zero_adds_no_effects():
    torque = ARM.torque(joint_2=quadratic(0.4), joint_1=spring(4.0, 1.0))
    loop = ARM.discover(torque, [*PLAIN, "viscous_quadratic"], max_effects=0)
    assert loop.effects_ == ()
    assert {u.joint for u in loop.unexplained_} == {0, 1}
    assert_array_equal(loop.error_after_, loop.error_plain_)


def test_a_custom_effect_is_found():
    torque = ARM.torque(joint_2=lambda r: 3 * r.q[:, 1] ** 3)
    loop = ARM.discover(torque, [*PLAIN, Cubic])
    assert ("cubic", 1) in named(loop)
    (effect,) = [e for e in loop.effects_ if e.name == "cubic"]
    assert effect.parameters["k3"] == pytest.approx(3.0, rel=0.05)
    assert effect.units["k3"] == "N m/rad^3"
    report = loop.report_
    for text in (str(report), text_of(report)):
        assert "stiffening cable" in text
        # Class names appear only in the lists of parameters and settings.
        shown = text.split("Identified parameters")[0].split("Searched for")[0]
        assert "cubic" not in shown
    assert effect.name in {e["name"] for e in report.to_dict()["effects"]}


def test_declared_effects_are_kept():
    torque = ARM.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    robot = ARM.robot(effects=(effects.Coulomb(1),))
    loop = ARM.discover(torque, PLAIN, robot=robot)
    assert named(loop) == [("spring", 0)]
    # The term is declared on every joint, and only once.
    assert [e.name for e in loop.declared_.effects_] == ["coulomb"]
    assert [e.name for e in loop.identifier_.effects_] == ["spring"]
    values = dict(zip(loop.identifier_.parameter_names_, loop.identifier_.theta_))
    assert values["joint_2:coulomb"] == pytest.approx(1.0, rel=0.05)
    assert values["joint_1:coulomb"] == pytest.approx(0.0, abs=0.05)
    assert loop.effects_[0].parameters["k"] == pytest.approx(4.0, rel=0.05)


def test_other_regressors_are_supported():
    robot = ARM.robot(regressor=LinearRegression(), projector=None)
    loop = ARM.discover(GOOD, PLAIN, robot=robot)
    assert named(loop) == [("spring", 0)]


# -- identifiability and unexplained torque


def test_identifiable_flags_of_friction_terms(springy):
    """Only the sum of rotor and link inertia of the first joint is identifiable."""
    flags = dict(
        zip(springy.identifier_.parameter_names_, springy.identifier_.identifiable_)
    )
    assert not flags["joint_1:rotor_inertia"]
    for name in ("joint_1:coulomb", "joint_2:coulomb", "joint_2:offset"):
        assert flags[name], name
    # The constant term of the spring replaces the offset.
    assert not flags["joint_1:offset"]
    assert flags["joint_1:spring:c"]
    # The weight of a vertical prismatic joint equals an offset.
    recording = record("zY", seed=0, size=0.4)
    loop = recording.discover(recording.torque(), ["spring"], max_effects=0)
    flags = dict(zip(loop.baseline_.parameter_names_, loop.baseline_.identifiable_))
    assert not flags["joint_1:offset"]
    assert flags["joint_2:offset"]


def test_unexcited_effects_are_reported():
    """A joint that hardly moves needs another motion."""
    recording = record("ZY", seed=0, size=0.02, noise=0.002, encoder=1e-7)
    loop = recording.discover(recording.torque(), ["counterbalance", "offset"])
    hidden = {(h.name, h.joint): h for h in loop.not_identifiable_}
    assert hidden["counterbalance", 1].reason == "excitation"
    assert hidden["counterbalance", 1].remedy == effects.Counterbalance.record
    assert hidden["counterbalance", 1].joint_name == "joint_2"


def test_terms_of_accepted_effects_are_not_reported_as_hidden(springy):
    assert ("offset", 0) not in {(h.name, h.joint) for h in springy.not_identifiable_}


OUTSIDE = {
    "a clock's": {"joint_1": lambda r: np.tanh(4 * np.sin(2 * np.pi * 0.37 * r.t))},
    "a product": {"joint_2": lambda r: 0.5 * np.sin(3 * r.q[:, 0] * r.q[:, 1])},
}


@pytest.mark.parametrize("kind", OUTSIDE)
def test_torques_outside_the_library_are_unexplained(kind):
    torques = OUTSIDE[kind]
    joint = int(next(iter(torques))[-1]) - 1
    library = ["coulomb", "spring", "load_friction", "coupling", "drift"]
    loop = ARM.discover(ARM.torque(**torques), library)
    assert loop.effects_ == ()
    (residual,) = loop.unexplained_
    assert residual.joint == joint
    assert residual.joint_name == f"joint_{joint + 1}"
    assert not residual.floor > 0.3 * residual.rms
    # The noise floor may be undefined.
    assert np.isnan(residual.floor) or residual.rms > 3 * residual.floor
    # Relative to the torque, as the error on held-out data.
    assert residual.of_torque == pytest.approx(loop.error_after_[joint], rel=0.1)


def test_unexplained_torque_names_the_dependent_signal():
    torque = ARM.torque(joint_1=lambda r: 1.5 * np.cos(6 * r.q[:, 1]))
    loop = ARM.discover(torque, ["coulomb"])
    assert loop.effects_ == ()
    (residual,) = loop.unexplained_
    assert residual.joint == 0
    assert residual.signals[0].signal == "position of joint_2"
    assert residual.signals[0].share > 0.3


def test_friction_that_depends_on_another_joint_is_no_delay():
    torque = ARM.torque(
        joint_1=lambda r: (1.0 + 0.8 * np.tanh(2 * r.q[:, 1])) * np.sign(r.v[:, 0])
    )
    loop = ARM.discover(torque, ["coulomb", "delay", "load_friction"])
    assert "delay" not in {e.name for e in loop.effects_}


# -- scikit-learn


def test_a_pickled_discovery_can_be_refitted(springy):
    copied = pickle.loads(pickle.dumps(springy))
    assert named(copied) == named(springy) == [("spring", 0)]
    assert_array_equal(copied.predict(ARM.position), springy.predict(ARM.position))
    assert str(copied.report_) == str(springy.report_)
    copied.fit(ARM.position, ARM.torque(joint_2=lambda r: 4.0 * r.q[:, 1]))
    assert named(copied) == [("spring", 1)]


# -- rejected input


def rejected(message, robot=None, X=ARM.position, y=GOOD, t=None, groups=None, **extra):
    search = EffectDiscovery(ARM.robot() if robot is None else robot, **extra)
    with pytest.raises(ValueError, match=message):
        search.fit(X, y, t=t, groups=groups)


@pytest.mark.parametrize(
    ("message", "options"),
    [
        ("Unknown effect 'stiction'; expected one of visc", {"effects": ["stiction"]}),
        ("effects names coulomb twice", {"effects": ["coulomb", "coulomb"]}),
        ("'alpha' .* must be a float in the range", {"alpha": 0.0}),
        ("'test_size' .* must be a float in the range", {"test_size": 0.0}),
        ("'max_effects' .* must be an int in the range", {"max_effects": -1}),
        (
            "must be an instance of .*RobotIdentifier.* LinearReg",
            {"robot": LinearRegression()},
        ),
        ("dt must be the sample period", {"robot": ARM.robot(dt=None)}),
        ("12 blocks", {"robot": ARM.robot(cutoff=0.6)}),
        (
            r'must have criterion="torque".*loop\.ident',
            {"robot": ARM.robot(criterion="simulation")},
        ),
    ],
)
def test_invalid_settings_are_rejected(message, options):
    rejected(message, **options)


@pytest.mark.parametrize(
    ("message", "options"),
    [
        ("y must have 2 column", {"y": GOOD[:, :1]}),
        ("degrees", {"X": np.degrees(ARM.position)}),
        ("X must have 2 columns", {"X": ARM.position[:, :1]}),
        ("t must", {"t": ARM.t[::-1]}),
        ("one label per row", {"groups": [1, 2]}),
        ("short|too little|at least", {"X": ARM.position[:5], "y": GOOD[:5]}),
        ("short|too little|at least", {"X": ARM.position[:20], "y": GOOD[:20]}),
    ],
)
def test_invalid_recordings_are_rejected(message, options):
    rejected(message, **options)


def test_predict_requires_fit():
    with pytest.raises(ValueError, match="not fitted"):
        EffectDiscovery(ARM.robot()).predict(ARM.position)


# -- torques of a drive


@pytest.mark.slow
def test_channel_effects_are_not_searched_for_drive_torques():
    motion = drives.told(duration=20.0)
    rng = np.random.default_rng(0)
    jerk = np.gradient(motion.states[:, 6:], drives.DT, axis=0)
    extra = -2e-3 * jerk * [0.0, 1.0, 0.0] + 0.05 * rng.standard_normal(jerk.shape)
    motion.signals["q_desired"] += extra / drives.KP
    drive = drives.PDDrive(drives.KP, drives.KD, delay=0.0)
    recording = drive.driven(motion)
    robot = RobotIdentifier(drives.ARM, dt=drives.DT)
    options = {"effects": ["jerk", "torque_filter", "delay"]}
    measured = EffectDiscovery(robot, **options).fit(recording.states, recording.tau)
    assert [x.joint for x in measured.effects_] == [1]
    by_drive = EffectDiscovery(clone(robot).set_params(drive=drive), **options)
    left_out = r"Not available with PDDrive: jerk \(.*; torque_filter \("
    with pytest.warns(UserWarning, match=left_out):
        by_drive.fit_recording(recording)
    assert by_drive.effects_ + by_drive.possible_ == ()
    assert max(by_drive.unexplained_, key=lambda x: x.rms).joint == 1


def test_a_doubtful_channel_raises_a_warning():
    arm = make_robot_recording(duration=20.0, dt=0.01, random_state=0)
    tau = arm.tau * np.where(np.arange(6) == 3, 1000.0, 1.0)
    search = EffectDiscovery(RobotIdentifier(arm.urdf, dt=arm.dt), effects=[])
    with pytest.warns(DoubtWarning, match="joint_4"):
        search.fit(arm.q, tau)
    assert [x.kind for x in search.report_.outcome.findings["channels"]] == [
        "gear_factor"
    ]


def test_a_recording_shorter_than_the_filter_is_named_once():
    names = np.where(np.arange(len(GOOD)) < len(GOOD) - 20, "long", "short")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ARM.discover(GOOD, ["spring"], groups=names)
    (text,) = {str(x.message) for x in caught if "low-pass" in str(x.message)}
    assert text.startswith("1 of 2 recordings (short) are shorter")

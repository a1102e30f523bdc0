"""Do torques have the sign of what they do."""

import numpy as np

from sklearn_vbjfa.robot._channel_evidence import SURE, fits_of
from sklearn_vbjfa.robot._channel_finding import ChannelFinding
from sklearn_vbjfa.robot._channel_fits import ChannelEquations

# Friction below this share of a torque says nothing of its sign.
_FRICTION_SHARE = 0.1
# Share of the torque that the nominal model must explain to say something.
_NOMINAL_SHARE = 0.5


def torque_signs(model, names, signals):
    """Find torques with the wrong sign.

    Parameters
    ----------
    model : pinocchio.Model
        Robot.
    names : sequence of str
        Joints.
    signals : ChannelSignals
        Filtered recording.

    Returns
    -------
    findings : list of ChannelFinding
        Errors.
    signals : ChannelSignals
        Recording with the signs put right.
    """
    equations = ChannelEquations(model, signals)
    found = []
    sign = np.ones(model.nv)
    for j, fit in fits_of(equations, signals).items():
        scale, scale_t, share = equations.nominal_scale(j)
        friction = fit.power_t * (fit.friction > _FRICTION_SHARE)
        rigid = scale_t * (share > _NOMINAL_SHARE)
        # Neither witness may say the contrary.
        says = min(friction, rigid)
        if says > -SURE or max(friction, rigid) > 2.0:
            continue
        sign[j] = -1.0
        evidence = []
        if friction < -SURE:
            evidence.append(
                f"friction would feed {-fit.power:.3g} W into the motion "
                f"({-fit.power_t:.0f} standard errors)"
            )
        if rigid < -SURE:
            evidence.append(
                f"it follows {scale:.2g} times the model's torque "
                f"({-scale_t:.0f} standard errors)"
            )
        found.append(
            ChannelFinding(
                "torque_sign",
                (j,),
                "error",
                f"The torque of {names[j]} has the wrong sign: "
                f"{' and '.join(evidence)}; multiply it by -1.",
            )
        )
    return found, signals.signed(sign)

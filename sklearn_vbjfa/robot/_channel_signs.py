"""Do torques have the sign of what they do."""

import numpy as np

from sklearn_vbjfa.robot._channel_evidence import SURE, fits_of
from sklearn_vbjfa.robot._channel_finding import ChannelFinding
from sklearn_vbjfa.robot._channel_fits import ChannelEquations

# Friction below this share of a torque is no evidence of its sign.
_FRICTION_SHARE = 0.1
# ... and below this it does not even contradict.
_CONTRADICTS = 0.02
# A torque of which the nominal one explains less than this does not follow it.
_FOLLOWS = 0.1
# A torque that neither inertias nor friction predict better has no friction to go by.
_WORST_ERROR = 0.3
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
        if fit.error[0] > _WORST_ERROR:
            continue
        # It takes more to accuse than to contradict.
        friction = fit.power_t * (fit.friction > _FRICTION_SHARE)
        rigid = scale_t * (share > _NOMINAL_SHARE)
        against = max(
            fit.power_t * (fit.friction > _CONTRADICTS),
            scale_t * (share > 0.5 * _NOMINAL_SHARE),
        )
        if min(friction, rigid) > -SURE or against > 2.0:
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
        # Where the model asks for a torque that the channel does not follow, with
        # neither sign, its friction may be what a controller compensates.
        follows = rigid < -SURE or scale_t == 0.0
        found.append(
            ChannelFinding(
                "torque_sign",
                (j,),
                "error" if follows or share > _FOLLOWS else "doubt",
                f"The torque of {names[j]} has the wrong sign: "
                f"{' and '.join(evidence)}; multiply it by -1.",
            )
        )
    return found, signals.signed(sign)

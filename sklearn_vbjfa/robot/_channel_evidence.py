"""What the checks of channels with a robot model have in common."""

import numpy as np

# Standard errors that evidence needs.
SURE = 5.0


def fits_of(equations, signals):
    """Fit of every informative joint with the torques as recorded.

    Parameters
    ----------
    equations : ChannelEquations
        Regressors.
    signals : ChannelSignals
        Signals that they were made of.

    Returns
    -------
    dict of int to ChannelFit
        Joints with enough rows.
    """
    now = signals.now
    return {
        int(j): equations.fit(j, now[:, [j]])
        for j in np.flatnonzero(signals.informative())
    }


def total(fits):
    """Logarithms of squared errors by block, mean over joints.

    A torque that is predicted worse than by its mean is not predicted: how much worse
    says nothing, and is no evidence for what predicts it a little less badly.
    """
    return np.mean(
        [np.minimum(fit.log_error[:, 0], fit.log_variance) for fit in fits.values()],
        axis=0,
    )

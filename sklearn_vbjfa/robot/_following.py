"""Bodies of joints that follow others, as effects that the robot declares by itself."""

import numpy as np

from sklearn_vbjfa.effects._follower import ChainJoint, Follower


def with_followers(effects, features):
    """Return the bodies of a robot's followers, and behind them declared effects.

    Parameters
    ----------
    effects : tuple of Effect
        What is declared; followers among them are taken from the robot instead.
    features : RigidBodyFeatures
        Loaded features.
    """
    declared = tuple(one for one in effects if not isinstance(one, Follower))
    return (*map(_follower, features.followers_), *declared)


def follower_parameters(effects, coefficients):
    """Return the inertial parameters (10,) of followers, by the joints' names.

    effects, coefficients : all effects of a robot and what each was found to be.
    """
    return {
        effect.of: np.asarray(own)
        for effect, own in zip(effects, coefficients)
        if isinstance(effect, Follower)
    }


def nominal_followers(features):
    """Inertial parameters of the followers in the description, (n, 10)."""
    found = [body.parameters for body in features.followers_]
    return np.reshape(found, (-1, 10))


def _follower(body):
    """Turn a `FollowingBody` into an effect."""
    chain = tuple(
        ChainJoint(
            joint=link.joint,
            rate=link.rate,
            offset=link.offset,
            slides=link.slides,
            place=tuple(link.placement.translation),
            frame=tuple(link.placement.rotation.ravel()),
            axis=tuple(link.axis),
        ).flat()
        for link in body.chain
    )
    return Follower(
        joint=body.leader,
        of=body.name,
        chain=chain,
        gravity=tuple(map(float, body.gravity)),
    )

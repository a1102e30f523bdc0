"""Metadata routing from a fit to the regressor of its equations."""

import numpy as np
from sklearn import get_config
from sklearn.utils.metadata_routing import (
    MetadataRouter,
    MethodMapping,
    get_routing_for_object,
)

# What the rows of the equations have, too; their instruments go along without asking.
_FORWARDED = ("groups", "sample_weight")


class ForwardingMixin:
    """Metadata routing of a meta-estimator that makes equations out of samples."""

    def get_metadata_routing(self):
        """Get the metadata routing of this object.

        Returns
        -------
        sklearn.utils.metadata_routing.MetadataRouter
            What the estimator itself requests, and its regressor where that requests
            `groups` or `sample_weight` by name.
        """
        router = MetadataRouter(owner=self).add_self_request(self)
        # A regressor that requests nothing would, as "not set", draw in what this
        # estimator was told to ignore.
        if self.regressor is not None and _requested(self.regressor):
            router.add(regressor=self.regressor, method_mapping=_fit_to_fit())
        return router

    def _forwarded(self, values):
        """Return what the regressor's `fit` requests, as keyword arguments.

        Parameters
        ----------
        values : dict of str to ndarray of shape (n_equations,)
            Groups and weights of the equations, as far as there are any.
        """
        if not get_config()["enable_metadata_routing"]:
            return {}
        requested = _requested(self.regressor_) & set(values)
        if not requested:
            return {}
        router = MetadataRouter(owner=self)
        router.add(regressor=self.regressor_, method_mapping=_fit_to_fit())
        params = {name: values[name] for name in requested}
        return dict(router.route_params(caller="fit", params=params)["regressor"].fit)


def labels_of_equations(labels, counted):
    """Repeat each piece's label for its equations.

    Parameters
    ----------
    labels : list
        One label a piece of the recording.
    counted : list of ndarray of shape (n_rows, nv), bool
        Which equations of each piece count.

    Returns
    -------
    ndarray of shape (n_equations,)
        Labels.
    """
    return np.repeat(np.asarray(labels), [int(keep.sum()) for keep in counted])


def _fit_to_fit():
    return MethodMapping().add(caller="fit", callee="fit")


def _requested(regressor):
    routing = get_routing_for_object(regressor)
    return set(routing.consumes("fit", _FORWARDED))

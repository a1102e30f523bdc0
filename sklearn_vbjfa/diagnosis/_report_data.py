"""A report as plain data."""

import dataclasses
import math
import numbers

import numpy as np
from sklearn.base import BaseEstimator

SCHEMA_VERSION = 3


def as_data(report):
    """Everything in a report but its curves, as JSON knows it."""
    outcome = report.outcome
    data = {
        "schema_version": SCHEMA_VERSION,
        "status": report.status,
        "headline": report.headline,
        "verdict": report.verdict,
        "joints": plain(report.joints),
    }
    for field in dataclasses.fields(outcome):
        if field.name != "curves":
            data[field.name] = plain(getattr(outcome, field.name))
    return data


def plain(value):
    """Turn a value into what JSON knows; nan and infinity become None."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(one) for one in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    if isinstance(value, BaseEstimator):
        parameters = value.get_params(deep=False)
        return {"class": type(value).__name__, "parameters": plain(parameters)}
    return str(value)

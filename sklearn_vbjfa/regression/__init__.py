"""Linear models with noisy inputs and outputs, and their rivals."""

from sklearn_vbjfa import _lazily

# For users they are in `sklearn_vbjfa`; the rest is for other subpackages and tests.
_MODULES = {
    "_base": "check_sample_weight",
    "_correlated": "LARGEST_FRACTION largest_noise_fraction",
    "_instrumental_variables": "InstrumentalVariables",
    "_joint_factor": "BaseJointFactorRegressor JFARegressor fit_moments",
    "_locally_weighted": "LocallyWeightedRegressor",
    "_stepwise": "StepwiseRegressor",
    "_total_least_squares": "NoiseCovariance TotalLeastSquares replicate_noise",
    "_vbjfa": "VBJFARegressor",
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)

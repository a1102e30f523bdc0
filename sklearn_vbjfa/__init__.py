"""Linear models with noisy inputs and outputs, made for robot identification."""

__version__ = "0.1.0.dev0"
__all__: list[str] = []

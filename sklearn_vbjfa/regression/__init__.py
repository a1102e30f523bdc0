"""Linear models with noisy inputs and outputs, and their rivals."""

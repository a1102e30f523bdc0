"""Pure NumPy mathematics of the estimators; knows nothing of scikit-learn."""

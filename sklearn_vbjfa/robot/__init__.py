"""Robots: states, features, identification. Pinocchio is imported here alone."""

"""Identified robots in motion: forward dynamics, and torques one state at a time.

Everything here takes a `TorqueModel`, which is what an identification leaves when data
and estimator are put away.
"""

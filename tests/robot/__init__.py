"""Tests of the robot chain."""

"""Diagnosis: what a robot model lacks."""

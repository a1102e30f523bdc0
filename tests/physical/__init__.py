"""Tests of the physical-consistency subpackage."""

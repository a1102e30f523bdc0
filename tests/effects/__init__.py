"""Tests of the effects that a rigid-body model may lack."""

"""Tests of the search for effects."""

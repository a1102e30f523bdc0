"""Literal transcriptions, the reference for tests of the package."""

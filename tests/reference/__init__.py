"""Literal transcriptions that the package is tested against."""

"""Tests of the core mathematics, one file for one module."""

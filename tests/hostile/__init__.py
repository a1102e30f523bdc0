"""Damaged, odd and hostile inputs of the command line."""

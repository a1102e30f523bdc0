"""Recordings: what they hold, how they are read, and faults of their samples."""

"""Search for effects that are missing from the declared model."""

"""The search for effects that the declared model lacks."""

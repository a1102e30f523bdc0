"""What a search leaves to be said: intervals, errors, limits, remains, pictures."""

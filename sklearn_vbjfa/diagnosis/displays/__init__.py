"""Figures of fitted models, drawn by matplotlib."""

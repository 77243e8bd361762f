"""Scenes drawn in text; `format.py` has the format, `layouts.py` the twenty layouts."""

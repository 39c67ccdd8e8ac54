"""Validation of what users pass in: arguments, arrays, options, positions."""

"""Strict reading of mesh files: damaged files are rejected."""

"""Mesh files, read strictly: what is damaged is refused."""

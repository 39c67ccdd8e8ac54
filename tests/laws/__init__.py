"""Drawn scenes, every public call, one brute force, and laws that join them."""

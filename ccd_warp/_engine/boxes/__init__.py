"""Boxes of primitives: trees, spatial hashes, their order, and which bodies come near another."""

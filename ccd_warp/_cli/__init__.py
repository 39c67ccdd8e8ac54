"""The command ``ccd-warp``."""

"""The public calls, which put the parts together."""

"""Calls at one time: what is near, what intersects, how far vertices may move."""

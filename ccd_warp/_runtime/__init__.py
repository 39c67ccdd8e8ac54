"""Kernel launches, the threads that share them, and their progress."""

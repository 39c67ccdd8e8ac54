"""Gradients of times of impact: on tapes, of contacts, and for other libraries."""

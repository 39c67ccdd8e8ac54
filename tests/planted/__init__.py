"""Faults that are planted in a copy of the project, one by one, where the tests have to find each."""

"""The input and the results of a step: positions, earliest times of impact, contacts."""

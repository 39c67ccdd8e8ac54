"""The stages of a step, and its two drivers: the host step, controlled by Python, and the recorded device step."""

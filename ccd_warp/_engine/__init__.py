"""The stages of a step, and its two drivers: the host's, which decides, and the device's, which is recorded."""

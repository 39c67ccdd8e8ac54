"""The driver of calls whose input and results stay on the device: it decides nothing."""

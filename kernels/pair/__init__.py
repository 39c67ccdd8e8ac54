"""One pair: its patch, the bounds of rounding, and the methods that find its earliest time of impact."""

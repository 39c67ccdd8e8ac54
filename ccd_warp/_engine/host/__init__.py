"""The driver of calls on the host: it reads counts back, and decides."""

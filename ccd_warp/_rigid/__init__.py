"""Bodies that turn: their motions and paths, the slices of a step, and their parts."""

"""What a step needs of a mesh: its primitives on the device, kinds of pairs, lengths, worlds, half-spaces."""

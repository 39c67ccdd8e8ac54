"""The search for pairs of overlapping boxes, with the filter and the cull."""

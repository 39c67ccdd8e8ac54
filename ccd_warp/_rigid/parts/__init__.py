"""The broad phase of rigid bodies: parts of them that may touch in some slice of a step."""

"""What is near, within a distance or through each other at one time."""

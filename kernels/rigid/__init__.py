"""The kernels of bodies that turn: where they are placed, how their paths are shortened, which parts are near."""

"""Thousands of throws at a cloth that waves, each aimed so that it hits at the time that it is told to.

Each throw is a world of its own: a small ball above a cloth that moves. One launch finds the times of impact of all,
and its backward pass on a tape of Warp how each changes with the velocity of its throw. A step of Newton's method along
that gradient corrects the speeds, and after three of them every ball hits on time. Where the ball hits, face, edge or
vertex, is not told to anyone: it may change on the way.

    pip install -e '.[viz]' && python examples/aim.py --output aim

takes some seconds, the loading of the kernels included, and draws aim/aim.png.
"""

import argparse
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import warp as wp
from numpy.typing import NDArray

import ccd_warp as ccd

CELLS = 6  # of the cloth on each side, which is 2 wide
BALL = 0.08 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
FACES = [[4, 0, 2], [4, 2, 1], [4, 1, 3], [4, 3, 0], [5, 2, 0], [5, 1, 2], [5, 3, 1], [5, 0, 3]]
DISTANCE = 0.01  # between surfaces at which they count as touching


@wp.kernel
def throw(
    start: wp.array2d[wp.vec3d],
    cloth: wp.array[wp.vec3d],
    velocity: wp.array[wp.vec3d],
    end: wp.array2d[wp.vec3d],
):
    """Where the vertices of each world are at the end of the step: those of its cloth, then those of its ball."""
    world, v = wp.tid()
    if v < cloth.shape[0]:
        end[world, v] = cloth[v]
    else:
        end[world, v] = start[world, v] + velocity[world]


def cloth_at(phase: float, height: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a cloth with a wave."""
    x, y = np.meshgrid(*[np.linspace(-1.0, 1.0, CELLS + 1)] * 2, indexing="ij")
    z = height + 0.12 * np.sin(4.0 * x + 2.0 * y + phase)
    corner = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).ravel()[:, None]
    faces = np.vstack([corner + [0, CELLS + 1, 1], corner + [1, CELLS + 1, CELLS + 2]])
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces


class Throws:
    """Throws from random places, at random velocities, and the time at which each is to hit."""

    def __init__(self, count: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        (cloth, faces), (waved, _) = cloth_at(0.0, 0.0), cloth_at(2.0, 0.25)
        mesh = ccd.CollisionMesh.from_arrays([(cloth, faces), (BALL, FACES)], self_collision=False).replicate(count)
        self.pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
        self.pipeline.reserve(max_pairs=400 * count, max_contacts=100 * count)
        places = rng.uniform([-0.5, -0.5, 1.5], [0.5, 0.5, 2.0], (count, 3))
        self.wished = rng.uniform(0.4, 0.9, count)
        self.velocity = wp.array(
            rng.uniform([-0.2, -0.2, -6.0], [0.2, 0.2, -3.0], (count, 3)), dtype=wp.vec3d, requires_grad=True
        )
        start = np.hstack([np.tile(cloth, (count, 1, 1)), BALL + places[:, None]])
        self.start = wp.array(start, dtype=wp.vec3d)
        self.cloth = wp.array(waved, dtype=wp.vec3d)

    def toi(self) -> NDArray[np.float64]:
        """Times of impact; afterwards the velocities have their gradients."""
        end = wp.empty(self.start.shape, dtype=wp.vec3d, requires_grad=True)
        tape = wp.Tape()
        with tape:
            wp.launch(throw, self.start.shape, [self.start, self.cloth, self.velocity], [end])
            result = self.pipeline.launch(self.start, end)
        self.velocity.grad.zero_()
        result.world_toi.grad.fill_(1.0)  # no world changes the toi of another
        tape.backward()
        assert not result.flags.numpy()[0] & (ccd.LaunchFlag.PAIRS_OVERFLOW | ccd.LaunchFlag.CONTACTS_OVERFLOW)
        return result.world_toi.numpy().copy()

    def correct(self, toi: NDArray[np.float64]) -> None:
        """A step of Newton's method for each speed, to the inverse of the wished time, with which speeds go.

        A throw that misses has no gradient, and stays as it is.
        """
        velocity = self.velocity.numpy()
        slope = (self.velocity.grad.numpy() * velocity).sum(axis=1)  # d toi / d speed, relative
        late = np.where(slope < 0, toi * (toi / self.wished - 1.0), 0.0)
        self.velocity.assign(velocity * (1.0 - late / np.where(slope < 0, slope, 1.0))[:, None])


def draw(errors: list[NDArray[np.float64]], path: Path) -> None:
    """Draw how far from their time the throws hit, over the corrections."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    shares = [np.maximum(np.quantile(errors, q, axis=1), 1e-16) for q in (0.5, 0.99, 1.0)]
    for share, label, color in zip(shares, ("half", "99 %", "all"), ("tab:blue", "tab:orange", "tab:red"), strict=True):
        axes.plot(share, "o-", color=color, label=f"{label} of the throws")
    axes.set(yscale="log", xlabel="corrections", ylabel="|toi − wished time|, in steps")
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description="Throws aimed at a cloth that waves, by gradients, in some seconds.")
    parser.add_argument("--throws", type=int, default=2000, help="default 2000")
    parser.add_argument("--corrections", type=int, default=5, help="default 5")
    parser.add_argument("--output", type=Path, help="folder for aim.png")
    arguments = parser.parse_args()
    if arguments.output and find_spec("matplotlib") is None:
        parser.error("--output needs matplotlib; install it with: pip install 'ccd-warp[viz]'")
    wp.config.log_level = wp.LOG_WARNING
    wp.set_device("cpu")
    throws, errors = Throws(arguments.throws), []
    begin = time.perf_counter()
    for _ in range(arguments.corrections + 1):
        toi = throws.toi()
        errors.append(np.abs(np.where(np.isfinite(toi), toi, 1.0) - throws.wished))
        throws.correct(toi)
    duration = time.perf_counter() - begin
    print("corrections   median error   worst error")
    for k, error in enumerate(errors):
        print(f"{k:11}   {np.median(error):12.1e}   {error.max():11.1e}")
    print(f"{(errors[-1] < 1e-6).sum():,} of {arguments.throws:,} throws hit on time, {duration:.1f} s")
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
        draw(errors, arguments.output / "aim.png")


if __name__ == "__main__":
    main()

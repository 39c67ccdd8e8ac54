"""How the height of a ball after a bounce changes with the height from which it is thrown, with and without toi.

A ball is thrown down on a floor and comes up again. Its height at the end is differentiated by a tape of Warp, through
all steps. Without the time of impact a step that ends below the floor turns the velocity round: the height from which
the ball comes then only shifts the end, so the derivative is 1, and a smaller step does not help. It has the wrong
sign: who starts higher arrives later, and has come up less. With the toi of `launch`, which has a gradient of its own,
the ball goes to the floor and back within the step, and the derivative tends to the true one.

    pip install -e '.[viz]' && python examples/bounce_gradient.py --output bounce

takes some seconds, the loading of the kernels included, and draws bounce/bounce_gradient.png.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import warp as wp

import ccd_warp as ccd

HEIGHT, SPEED, GRAVITY, RESTITUTION, DURATION = 1.0, -3.0, -2.0, 0.8, 0.6
STEPS = [6, 12, 25, 50, 100, 200]

FLOOR = np.array([[-5.0, -5, 0], [5, -5, 0], [0, 8, 0]])
BALL = 0.2 * np.array(
    [[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1], [0.1, 0.2, 0], [0, 0, 2]]
)  # height 0 at its foot
FACES = [[4, 0, 2], [4, 2, 1], [4, 1, 3], [4, 3, 0], [5, 2, 0], [5, 1, 2], [5, 3, 1], [5, 0, 3]]


@wp.kernel
def fall(
    shape: wp.array[wp.vec3d],
    height: wp.array[wp.float64],
    speed: wp.array[wp.float64],
    dt: wp.float64,
    gravity: wp.float64,
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
):
    """Where the vertices of the ball are at both ends of a step without a floor."""
    v = wp.tid()
    up = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
    start[v] = shape[v] + height[0] * up
    end[v] = start[v] + dt * (speed[0] + wp.float64(0.5) * dt * gravity) * up


@wp.kernel
def bounce(
    height: wp.array[wp.float64],
    speed: wp.array[wp.float64],
    toi: wp.array[wp.float64],
    dt: wp.float64,
    gravity: wp.float64,
    restitution: wp.float64,
    new_height: wp.array[wp.float64],
    new_speed: wp.array[wp.float64],
):
    """Go to the floor within the step, if it is reached, and from there with the speed that is left."""
    fraction = wp.min(toi[0], wp.float64(1.0))
    rest = (wp.float64(1.0) - fraction) * dt
    h = height[0] + fraction * dt * (speed[0] + wp.float64(0.5) * dt * gravity)
    s = speed[0] + fraction * dt * gravity
    if toi[0] <= wp.float64(1.0):
        s = -restitution * s
    new_height[0] = h + rest * (s + wp.float64(0.5) * rest * gravity)
    new_speed[0] = s + rest * gravity


@wp.kernel
def turn_round(
    height: wp.array[wp.float64],
    speed: wp.array[wp.float64],
    dt: wp.float64,
    gravity: wp.float64,
    restitution: wp.float64,
    new_height: wp.array[wp.float64],
    new_speed: wp.array[wp.float64],
):
    """Turn the velocity round where the step would end below the floor."""
    s = speed[0]
    if height[0] + dt * (s + wp.float64(0.5) * dt * gravity) < wp.float64(0.0):
        s = -restitution * s
    new_height[0] = height[0] + dt * (s + wp.float64(0.5) * dt * gravity)
    new_speed[0] = s + dt * gravity


def number(value: float = 0.0) -> wp.array:
    """A number that has a gradient."""
    return wp.array([value], dtype=wp.float64, requires_grad=True)


def thrown(pipeline: ccd.CollisionPipeline, num_steps: int, *, with_toi: bool) -> tuple[float, float]:
    """The height of the ball at the end, and its derivative by that at the start."""
    dt = DURATION / num_steps
    shape = wp.array(BALL, dtype=wp.vec3d)
    first = height = number(HEIGHT)
    speed = number(SPEED)
    tape = wp.Tape()
    with tape:
        for _ in range(num_steps):
            start, end = (wp.zeros(len(BALL), dtype=wp.vec3d, requires_grad=True) for _ in range(2))
            new_height, new_speed = number(), number()
            if with_toi:
                wp.launch(fall, len(BALL), [shape, height, speed, dt, GRAVITY], [start, end])
                toi = pipeline.launch(start, end).toi
                wp.launch(bounce, 1, [height, speed, toi, dt, GRAVITY, RESTITUTION], [new_height, new_speed])
            else:
                wp.launch(turn_round, 1, [height, speed, dt, GRAVITY, RESTITUTION], [new_height, new_speed])
            height, speed = new_height, new_speed
    tape.backward(height)
    return float(height.numpy()[0]), float(first.grad.numpy()[0])


def true_derivative() -> float:
    """That of a ball that falls on a parabola."""
    impact = np.sqrt(SPEED**2 - 2 * GRAVITY * HEIGHT)  # speed on the floor
    time = (impact + SPEED) / -GRAVITY
    later = 1.0 / impact  # the time of impact, by the height
    rest = DURATION - time
    return RESTITUTION * (-GRAVITY * later * rest - impact * later) - GRAVITY * rest * later


def draw(sizes: list[float], with_toi: list[float], without: list[float], path: Path) -> None:
    """Draw both derivatives over the size of the step, beside the true one."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    axes.axhline(true_derivative(), color="black", linewidth=1, label="true")
    axes.plot(sizes, with_toi, "o-", color="tab:blue", label="with the gradient of toi")
    axes.plot(sizes, without, "s-", color="tab:red", label="velocity turned round at the end of a step")
    axes.set(xscale="log", xlabel="size of a step [s]", ylabel="d height at the end / d height at the start")
    axes.invert_xaxis()
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description="The gradient of a bounce, with and without toi, in some seconds.")
    parser.add_argument("--output", type=Path, help="folder for bounce_gradient.png")
    arguments = parser.parse_args()
    if arguments.output and find_spec("matplotlib") is None:
        parser.error("--output needs matplotlib; install it with: pip install 'ccd-warp[viz]'")
    wp.config.log_level = wp.LOG_WARNING
    wp.set_device("cpu")
    floor = (FLOOR, np.array([[0, 1, 2]]))
    mesh = ccd.CollisionMesh.from_arrays([floor, (BALL + [0, 0, HEIGHT], np.array(FACES))], static=[0])
    pipeline = ccd.CollisionPipeline(mesh)
    found = [[thrown(pipeline, n, with_toi=with_toi) for n in STEPS] for with_toi in (True, False)]
    print("steps   with toi   without")
    for n, (_, ours), (_, theirs) in zip(STEPS, *found, strict=True):
        print(f"{n:5}   {ours:8.4f}   {theirs:7.4f}")
    print(f"true    {true_derivative():8.4f}")
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
        of_steps = [[derivative for _, derivative in each] for each in found]
        draw([DURATION / n for n in STEPS], *of_steps, arguments.output / "bounce_gradient.png")


if __name__ == "__main__":
    main()

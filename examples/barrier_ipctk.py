"""The scene of barrier_solver.py by ccd_warp and by ipctk, each with its own search, barrier and CCD, compared.

The energy of both is the same up to rounding: ipctk lists each two closest features once and weighs them by the number
of pairs of primitives that share them, and `find_proximity` lists these pairs. Hessians and steps differ: that of ipctk
has the curvature of distances, projected to be positive semidefinite for each pair, and its CCD keeps other gaps. So
Newton's method stops at other points within its tolerance, and small differences grow while the strip buckles.

    pip install -e '.[bench,examples]' && python examples/barrier_ipctk.py --output fold

It takes 40 s on two cores.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from barrier_solver import KEY_FRAMES, RANGE, STIFFNESS, Array, Barrier, Fold, draw, run

import ccd_warp as ccd

try:
    import ipctk
except ImportError as error:
    sys.exit(f"barrier_ipctk.py: {error}; install with: pip install 'ccd-warp[bench]'")


class IpctkBarrier:
    """What `Barrier` has, by ipctk."""

    def __init__(self, mesh: ccd.CollisionMesh) -> None:
        num_moving = len(np.unique(mesh.faces[mesh.face_body == 0]))
        self.mesh = ipctk.CollisionMesh.build_from_full_mesh(mesh.vertices, mesh.edges, mesh.faces)
        self.mesh.can_collide = ipctk.make_static_obstacle_filter(num_moving)
        self.potential = ipctk.BarrierPotential(RANGE, STIFFNESS)

    def energy(self, x: Array) -> tuple[float, tuple[Any, Array]]:
        """The energy, and what its derivatives are computed from."""
        near, surface = ipctk.NormalCollisions(), self.mesh.vertices(x)
        near.build(self.mesh, surface, RANGE)
        return self.potential(near, self.mesh, surface), (near, surface)

    def derivatives(self, near: Any, surface: Array) -> tuple[Array, Any]:
        """Gradient and projected Hessian."""
        gradient = self.potential.gradient(near, self.mesh, surface)
        hessian = self.potential.hessian(near, self.mesh, surface, ipctk.PSDProjectionMethod.CLAMP)
        return self.mesh.to_full_dof(gradient), self.mesh.to_full_dof(hessian)

    def free_step(self, x: Array, end: Array) -> float:
        """Up to which fraction of the way nothing passes."""
        surfaces = self.mesh.vertices(x), self.mesh.vertices(end)
        # its additive CCD, much the faster one here; without the argument it is Tight-Inclusion
        return ipctk.compute_collision_free_stepsize(self.mesh, *surfaces, narrow_phase_ccd=ipctk.AdditiveCCD())


class Timed:
    """Contacts, whose seconds are added up by the name of the call."""

    def __init__(self, contact: Any) -> None:
        self.contact = contact
        self.seconds = {"energy": 0.0, "derivatives": 0.0, "free_step": 0.0}

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = getattr(self.contact, name)(*arguments)
            self.seconds[name] += time.perf_counter() - begin
            return result

        return call


def main() -> None:
    """Run both, and compare."""
    parser = argparse.ArgumentParser(
        description="A strip folds in a glass, by ccd_warp and by ipctk: 40 s on two cores."
    )
    parser.add_argument("--frames", type=int, default=100, help="40 a second (default 100)")
    parser.add_argument("--output", type=Path, help="folder for barrier_ipctk.png (none is drawn without)")
    options = parser.parse_args()
    if options.frames < 1:
        parser.error("expected --frames of at least 1")
    rows = []
    for name, contact in (("ccd_warp", Barrier), ("ipctk", IpctkBarrier)):
        scene = Fold(contact)
        scene.contact = Timed(scene.contact)
        rows.append(run(name, scene, options.frames))
        shares = ", ".join(f"{call} {1e3 * t / options.frames:.1f}" for call, t in scene.contact.seconds.items())
        print(f"  ms a frame: {shares}")
    apart = 1e3 * np.abs(np.subtract(*([x for _, x in row] for row in rows))).max(axis=(1, 2))
    print(f"at most {apart.max():.2g} mm apart, in the end {apart[-1]:.2g} mm")
    if options.output is not None:
        chosen = [k for k in KEY_FRAMES if k < options.frames] + [options.frames]
        draw(options.output / "barrier_ipctk.png", scene.mesh, [[row[k - 1] for k in chosen] for row in rows])


if __name__ == "__main__":
    main()

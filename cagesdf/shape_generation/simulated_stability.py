"""Whether a cage stays standing when it is let go and pushed: ShapeAssembly's test of stability, in Bullet.

Each connected part is one rigid body of solid cuboids of one density; bodies pass through each other. Each is let go
where it is, on a plane through the cage's lowest corner, gravity along -y, and is pushed up and turned in the first
step. It is stable if in the end its centre of mass is as high as it was, up to TOLERANCE of the body's height. Their
forces are 1000 times a volume and a length, with masses that aren't stated; here they are those of mass 1000 a volume.

The optional extra `physics` (pip install 'cagesdf[physics]') has the simulator; `static_stability.stable` needs none.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.shape_generation.static_stability import components, rooted

STEPS = 10_000  # of 1/240 s
GRAVITY = 9.8
TOLERANCE = 0.025  # of the height
# Push of the first step, in masses times the shorter side of the ground that the body covers: up, and about x, y, z.
LIFT, TURNS = 1.0, (0.004, 0.08, 0.004)


def stays_standing(cage: Cage) -> bool:
    """Whether the cage is rooted and each of its connected parts stays standing. Raises InputError without Bullet."""
    if not rooted(cage):
        return False
    component, ground = components(cage), float(cage.corners()[:, :, 1].min())
    lifted = Cage(cage.part_ids, cage.centre - [0.0, ground, 0.0], cage.axes, cage.size)
    return all(_body_stays(_of(lifted, component == label)) for label in sorted(set(component)))


def inertia(body: Cage) -> tuple[float, Float[ndarray, " 3"], Float[ndarray, "3 3"]]:
    """Mass, centre of mass and inertia tensor about it, of solid cuboids of density 1; overlaps count twice."""
    mass = body.size.prod(axis=1)
    centre = np.average(body.centre, axis=0, weights=mass)
    square = body.size**2
    moments = mass[:, None] / 12 * (square.sum(axis=1, keepdims=True) - square)
    turned = np.einsum("kia,ki,kib->kab", body.axes, moments, body.axes)
    arm = body.centre - centre
    steiner = mass[:, None, None] * ((arm**2).sum(axis=1)[:, None, None] * np.eye(3) - arm[:, :, None] * arm[:, None])
    return float(mass.sum()), centre, (turned + steiner).sum(axis=0)


def _of(cage: Cage, chosen: ndarray) -> Cage:
    names = tuple(part for part, is_chosen in zip(cage.part_ids, chosen) if is_chosen)
    return Cage(names, cage.centre[chosen], cage.axes[chosen], cage.size[chosen])


def _body_stays(body: Cage) -> bool:
    """Whether one rigid body above the plane y = 0 stays standing."""
    bullet = _bullet()
    mass, centre, tensor = inertia(body)
    moments, principal = np.linalg.eigh(tensor)
    principal[:, 0] *= np.sign(np.linalg.det(principal))
    corners = body.corners().reshape(-1, 3)
    across = float(np.ptp(corners, axis=0)[[0, 2]].min())
    world = bullet.connect(bullet.DIRECT)
    try:
        bullet.setGravity(0, -GRAVITY, 0, physicsClientId=world)
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 1, 0], physicsClientId=world)
        bullet.createMultiBody(0, plane, physicsClientId=world)
        boxes = bullet.createCollisionShapeArray(
            shapeTypes=[bullet.GEOM_BOX] * len(body),
            halfExtents=(body.size / 2).tolist(),
            collisionFramePositions=body.centre.tolist(),
            collisionFrameOrientations=Rotation.from_matrix(body.axes.transpose(0, 2, 1)).as_quat().tolist(),
            physicsClientId=world,
        )
        number = bullet.createMultiBody(
            mass, boxes,
            baseInertialFramePosition=centre.tolist(),
            baseInertialFrameOrientation=Rotation.from_matrix(principal).as_quat().tolist(),
            physicsClientId=world,
        )  # fmt: skip
        bullet.changeDynamics(number, -1, localInertiaDiagonal=moments.tolist(), physicsClientId=world)
        push, middle = mass * across, centre.tolist()
        bullet.applyExternalForce(number, -1, [0, LIFT * push, 0], middle, bullet.WORLD_FRAME, physicsClientId=world)
        turn = [push * about for about in TURNS]
        bullet.applyExternalTorque(number, -1, turn, bullet.WORLD_FRAME, physicsClientId=world)
        for _ in range(STEPS):
            bullet.stepSimulation(physicsClientId=world)
        height = bullet.getBasePositionAndOrientation(number, physicsClientId=world)[0][1]  # of the centre of mass
        return bool(abs(height - centre[1]) <= TOLERANCE * corners[:, 1].max())
    finally:
        bullet.disconnect(world)


def _bullet() -> Any:
    try:
        import pybullet
    except ImportError as error:
        raise InputError(
            "stability by simulation needs Bullet: pip install 'cagesdf[physics]'; or take support"
        ) from error
    return pybullet

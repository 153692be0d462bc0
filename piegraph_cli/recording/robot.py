"""Where the robot's base stands in the world: from poses of a board on its gripper, and from points that its tip touched."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from piegraph_cli.errors import DataError

FEWEST = 3
"""Pairs of poses, and points."""
TURN = 5.0
"""Degrees (root mean square) that the gripper has to turn about a second axis."""
LINE = 0.02, 0.05
"""Metres, and share of their longest extent, that points have to be apart across a line."""
POOR, WRONG = (0.005, 1.0), (0.02, 5.0)
"""Residual (m, deg) that is said, and that is refused."""
OPEN = 0.01, 1.0
"""Deviation (m, deg) of the base's pose that is too much."""
WEIGHT = 0.001, np.radians(0.1)
"""Metres and radians that weigh alike."""
REACH = 10.0
"""Metres: no arm is longer."""
BETTER = 0.3
"""A cause is named if undoing it leaves this share of the residual."""


@dataclass(frozen=True)
class Residual:
    """Root mean square."""

    metres: float
    degrees: float

    @property
    def size(self) -> float:
        """As a share of what is refused."""
        return max(self.metres / WRONG[0], self.degrees / WRONG[1])


@dataclass(frozen=True)
class Base:
    """The robot's base, as one fit has it."""

    T_world_robot: np.ndarray
    """[4, 4]."""
    T_gripper_board: np.ndarray
    """[4, 4]: where the board sits on the gripper."""
    residual: Residual


def hand_eye(gripper: np.ndarray, board: np.ndarray) -> dict[str, Base]:
    """The base by each method, `refined` last: that of least squares from the best of them.

    `gripper` [N, 4, 4] is T_robot_gripper by the robot, `board` [N, 4, 4] T_world_board as the cameras saw it then, metres.
    Raises `DataError` where poses are too few or turn about one axis only, the result is open, or they contradict each
    other; then slips in the robot's poses are tried, and named where undoing one helps.

    Source: Tsai and Lenz 1989; Park and Martin 1994; Daniilidis 1999; Shah 2013.
    """
    _check_turns(gripper)
    found = _by_methods(gripper, board)
    best = min(found.values(), key=lambda base: base.residual.size)
    refined, deviation = _refined(best, gripper, board)
    if refined.residual.size > 1:
        off = f"{1000 * refined.residual.metres:.0f} mm, {refined.residual.degrees:.1f} deg"
        message = f"the poses contradict each other: {off}"
        raise DataError(message, hint=_slip(gripper, board, refined.residual))
    if deviation.metres > OPEN[0] or deviation.degrees > OPEN[1]:
        raise DataError(
            f"the poses leave the base open by {1000 * deviation.metres:.0f} mm and {deviation.degrees:.1f} deg",
            hint="take more poses, and turn the gripper by 30 degrees and more about two axes",
        )
    return found | {"refined": refined}


def _check_turns(gripper: np.ndarray) -> None:
    from scipy.spatial.transform import Rotation

    if len(gripper) < FEWEST:
        raise DataError(f"{len(gripper)} poses in which the board is seen, {FEWEST} are needed", hint="ten are better")
    turns = Rotation.from_matrix(gripper[:, :3, :3])
    vectors = np.array([(turns[i] * turns[j].inv()).as_rotvec() for i, j in combinations(range(len(gripper)), 2)])
    spread = np.degrees(np.linalg.svd(vectors, compute_uv=False)[:2]) / np.sqrt(len(vectors))
    if len(spread) < 2 or spread[1] < TURN:
        turned = "hardly turns" if spread[0] < TURN else "turns about one axis only"
        raise DataError(
            f"the gripper {turned}: that does not tell where the base is",
            hint="turn it by 30 degrees and more about two axes that are not parallel, between the poses",
        )


def _by_methods(gripper: np.ndarray, board: np.ndarray) -> dict[str, Base]:
    pairs = list(combinations(range(len(gripper)), 2))
    # board_i board_j^-1 = X (gripper_i gripper_j^-1) X^-1
    A = np.array([board[i] @ np.linalg.inv(board[j]) for i, j in pairs])
    B = np.array([gripper[i] @ np.linalg.inv(gripper[j]) for i, j in pairs])
    methods: dict[str, Callable[[], np.ndarray]] = {
        "tsai": lambda: _with_shift(_tsai(A, B), A, B),
        "park": lambda: _with_shift(_park(A, B), A, B),
        "daniilidis": lambda: _daniilidis(A, B),
        "shah": lambda: _shah(board, gripper),
    }
    return {name: _based(method(), gripper, board) for name, method in methods.items()}


def _based(T: np.ndarray, gripper: np.ndarray, board: np.ndarray) -> Base:
    """The base with the mean place of the board on the gripper that follows."""
    from scipy.spatial.transform import Rotation

    places = np.linalg.inv(T @ gripper) @ board
    Y = np.eye(4)
    Y[:3, :3] = Rotation.from_matrix(places[:, :3, :3]).mean().as_matrix()
    Y[:3, 3] = places[:, :3, 3].mean(0)
    return Base(T, Y, _residual(_off(T, Y, gripper, board)))


def _off(X: np.ndarray, Y: np.ndarray, gripper: np.ndarray, board: np.ndarray) -> np.ndarray:
    """How far [N, 6] (m, rad) the board is from where the robot says it is."""
    from scipy.spatial.transform import Rotation

    said = X @ gripper @ Y
    turn = Rotation.from_matrix(board[:, :3, :3].transpose(0, 2, 1) @ said[:, :3, :3]).as_rotvec()
    return np.concatenate([said[:, :3, 3] - board[:, :3, 3], turn], 1)


def _residual(off: np.ndarray) -> Residual:
    metres, radians = (float(np.sqrt((part**2).sum(1).mean())) for part in (off[:, :3], off[:, 3:]))
    return Residual(metres, float(np.degrees(radians)))


def _refined(start: Base, gripper: np.ndarray, board: np.ndarray) -> tuple[Base, Residual]:
    """The least squares fit, and how well it determines the base where the gripper was."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    middle = gripper[:, :3, 3].mean(0)

    def moved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        X, Y = start.T_world_robot.copy(), start.T_gripper_board.copy()
        X[:3, :3] = X[:3, :3] @ Rotation.from_rotvec(x[:3]).as_matrix()
        # the base turns about the middle of the poses, where it is known best
        X[:3, 3] += x[3:6] + (start.T_world_robot[:3, :3] - X[:3, :3]) @ middle
        Y[:3, :3], Y[:3, 3] = Y[:3, :3] @ Rotation.from_rotvec(x[6:9]).as_matrix(), Y[:3, 3] + x[9:]
        return X, Y

    def weighed(x: np.ndarray) -> np.ndarray:
        off = _off(*moved(x), gripper, board)
        return np.concatenate([off[:, :3] / WEIGHT[0], off[:, 3:] / WEIGHT[1]], 1).ravel()

    fit = least_squares(weighed, np.zeros(12), x_scale="jac", loss="soft_l1", f_scale=3.0)
    X, Y = moved(fit.x)
    noise = float((fit.fun**2).sum()) / max(1, len(fit.fun) - 12)
    variance = np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * noise
    deviation = Residual(float(np.sqrt(variance[3:6].sum())), float(np.degrees(np.sqrt(variance[:3].sum()))))
    return Base(X, Y, _residual(_off(X, Y, gripper, board))), deviation


def _slip(gripper: np.ndarray, board: np.ndarray, residual: Residual) -> str:
    """What to try: a usual slip in the robot's poses, if undoing it makes them fit."""
    from scipy.spatial.transform import Rotation

    def turned(make: Callable[[np.ndarray], Rotation]) -> np.ndarray:
        changed = gripper.copy()
        changed[:, :3, :3] = make(gripper[:, :3, :3]).as_matrix()
        return changed

    def as_vectors(R: np.ndarray) -> np.ndarray:
        return Rotation.from_matrix(R).as_rotvec()

    def swapped(R: np.ndarray) -> Rotation:
        return Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), -1, axis=1))

    slips = {
        "the poses map the base into the gripper: write their inverses": np.linalg.inv(gripper),
        "the quaternions have w first: name the columns qw,qx,qy,qz": turned(swapped),
        "rx, ry, rz are angles about fixed axes (roll, pitch, yaw), not a rotation vector: write quaternions": turned(
            lambda R: Rotation.from_euler("xyz", as_vectors(R))
        ),
    }
    for text, changed in slips.items():
        undone = _refined(min(_by_methods(changed, board).values(), key=lambda b: b.residual.size), changed, board)[0]
        if undone.residual.size < min(1, BETTER * residual.size):
            return text
    return "each pose has to be that of its image, robot at rest; check units, the board's squares, and that it sits firmly"


def _tsai(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    a, b = (_half_axes(M) for M in (A, B))
    half = np.linalg.lstsq(np.concatenate(_cross(a + b)), (b - a).ravel(), rcond=None)[0]
    # of the half angle's tangent along the axis
    return Rotation.from_quat([*half, 1.0]).as_matrix()


def _half_axes(M: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return 2 * Rotation.from_matrix(M[:, :3, :3]).as_quat(canonical=True)[:, :3]


def _park(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    a, b = (Rotation.from_matrix(M[:, :3, :3]).as_rotvec() for M in (A, B))
    return nearest_rotation(a.T @ b)


def _with_shift(R: np.ndarray, A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The base's pose, from its rotation."""
    left = np.concatenate(A[:, :3, :3] - np.eye(3))
    right = (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.linalg.lstsq(left, right, rcond=None)[0]
    return T


def _daniilidis(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Rotation and shift at once, by dual quaternions."""
    from scipy.spatial.transform import Rotation

    (a, a_dual), (b, b_dual) = (_dual(M) for M in (A, B))
    rows = np.zeros((len(A), 6, 8))
    rows[:, :3, 0] = rows[:, 3:, 4] = a - b
    rows[:, :3, 1:4] = rows[:, 3:, 5:] = _cross(a + b)
    rows[:, 3:, 0], rows[:, 3:, 1:4] = a_dual - b_dual, _cross(a_dual + b_dual)
    u, v = np.linalg.svd(rows.reshape(-1, 8))[2][-2:]
    # of the plane of solutions: a unit dual quaternion
    coefficients = [u[:4] @ u[4:], u[:4] @ v[4:] + u[4:] @ v[:4], v[:4] @ v[4:]]
    roots = np.real(np.roots(coefficients)) if abs(coefficients[0]) > 1e-15 else np.array([0.0])
    norms = [r**2 * u[:4] @ u[:4] + 2 * r * u[:4] @ v[:4] + v[:4] @ v[:4] for r in roots]
    root, norm = max(zip(roots, norms, strict=True), key=lambda pair: pair[1])
    q = (root * u + v) / np.sqrt(norm)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([*q[1:4], q[0]]).as_matrix()
    w, x = q[0], q[1:4]
    T[:3, 3] = 2 * (-q[4] * x + w * q[5:] - np.cross(q[5:], x))
    return T


def _dual(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vector parts [N, 3] of motions [N, 4, 4] as dual quaternions."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(M[:, :3, :3]).as_quat(canonical=True)
    return q[:, :3], 0.5 * (q[:, 3:] * M[:, :3, 3] + np.cross(M[:, :3, 3], q[:, :3]))


def _shah(board: np.ndarray, gripper: np.ndarray) -> np.ndarray:
    """Base and board at once, by the Kronecker product: board_i Z = X gripper_i."""
    R_A, R_B = board[:, :3, :3], gripper[:, :3, :3]
    u, _, _ = np.linalg.svd(sum(np.kron(b, a) for a, b in zip(R_A, R_B, strict=True)))
    X = nearest_rotation(_rescaled(u[:, 0].reshape(3, 3, order="F")))
    left = np.concatenate([np.concatenate([-a, np.eye(3)], 1) for a in R_A])
    right = (board[:, :3, 3] - gripper[:, :3, 3] @ X.T).ravel()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = X, np.linalg.lstsq(left, right, rcond=None)[0][3:]
    return T


def _rescaled(M: np.ndarray) -> np.ndarray:
    return M * np.sign(np.linalg.det(M))


def nearest_rotation(M: np.ndarray) -> np.ndarray:
    """The rotation [3, 3] nearest to a matrix."""
    u, _, vt = np.linalg.svd(M)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt


def _cross(vectors: np.ndarray) -> np.ndarray:
    """Matrices [N, 3, 3] that take the cross product with vectors [N, 3]."""
    x, y, z = vectors.T
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(-1, 3, 3)


def touched(robot: np.ndarray, world: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """`T_world_robot` [4, 4] from points [N, 3] (m) that the tip touched, and how far [N] (m) each is off.

    `names` are the points' for messages. Raises `DataError` where they are too few, lie in a line, or do not fit.
    """
    if len(robot) < FEWEST:
        raise DataError(f"{len(robot)} points, {FEWEST} are needed", hint="touch four, far apart, not in a line")
    if np.abs(robot).max() > REACH:
        raise DataError(f"a point {np.abs(robot).max():g} m from the robot's base", hint="give metres, not millimetres")
    for of, points in (("the robot", robot), ("the world", world)):
        extent = np.linalg.svd(points - points.mean(0), compute_uv=False)[1] / np.sqrt(len(points))
        longest = np.linalg.norm(np.ptp(points, axis=0))
        if extent < max(LINE[0] / 2, LINE[1] * longest):
            raise DataError(
                f"the points lie in a line, or in one place, for {of}", hint="touch points far apart in a plane"
            )
    centre, there = robot.mean(0), world.mean(0)
    spread = (world - there).T @ (robot - centre)
    T = np.eye(4)
    T[:3, :3] = nearest_rotation(spread)
    T[:3, 3] = there - T[:3, :3] @ centre
    off = np.linalg.norm(robot @ T[:3, :3].T + T[:3, 3] - world, axis=1)
    if np.sqrt((off**2).mean()) > WRONG[0]:
        u, _, vt = np.linalg.svd(spread)
        mirrored = np.linalg.norm((robot - centre) @ (u @ vt).T + there - world, axis=1)
        size = np.linalg.norm(world - there) / np.linalg.norm(robot - centre)
        if np.sqrt((mirrored**2).mean()) < BETTER * WRONG[0]:
            hint = "the points fit as mirrored: two axes are exchanged in one of the two"
        elif abs(size - 1) > 0.05:
            hint = f"in the world they are {size:.3g} times as far apart as for the robot: check units, and the board's squares"
        else:
            hint = "check the order of the points, and the robot's tool centre point"
        worst = int(off.argmax())
        raise DataError(f"the points do not fit: {names[worst]} is {1000 * off[worst]:.0f} mm off", hint=hint)
    return T, off

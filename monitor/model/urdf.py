"""URDF: read any serial arm, and write an identified arm.

Reading: revolute and continuous joints in one chain; fixed joints are merged. Consecutive joint axes give standard DH frames. Where two
axes are nearly parallel, their common normal is far away, and an offset along y takes its place (`Robot.y_m`).
Writing: link frame i is DH frame i−1 turned by qᵢ, so every joint turns about z.
"""

import math
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree as ET

import numpy as np

from monitor.errors import BadInput
from monitor.model.robot import Robot
from monitor.model.transmission import drives_of
from monitor.recording import Array

MAX_JOINTS = 8
LARGEST = 1e5  # [m, kg, rad] no arm has a larger figure
UNLIMITED = 1e9  # a URDF must give effort and speed, and has no infinity: a limit of this size or more counts as unknown
PARALLEL = 1e-12  # sine of the angle between two axes; a smaller one is rounding
NEARLY_PARALLEL = 1e-3  # sine; with a smaller one the common normal may be kilometres away


@dataclass(slots=True, eq=False)
class _Body:
    """Links that move together, with all joints at zero, in the base link's frame: mass, first and second moments about its origin."""

    name: str
    joint: str  # that carries the body
    origin: Array  # (3,) a point on the axis of the joint that carries the body [m]
    axis: Array  # (3,) unit vector of that axis
    limits: dict[str, float]  # sizes of the joint's limits; infinite where not given
    mass_kg: float = 0.0
    first_kg_m: Array = field(default_factory=lambda: np.zeros(3))
    second_kg_m2: Array = field(default_factory=lambda: np.zeros((3, 3)))  # (3, 3) ∫ x xᵀ dm


def robot_from_urdf_text(text: str, source: str = "URDF") -> Robot:
    """The arm that a URDF describes; joint 1 is the one next to the base.

    Gear ratios and coupled motors are those of its transmissions; torque constants and payload are not part of it and are NaN.
    A limit that is not given is infinite. The flange's frame is that of the last joint, turned so that z is its axis.
    Raises BadInput that says what is wrong, where, and what would be right.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadInput(f"{source}: holds a document type; a URDF needs none, and entities can be made to explode")
    try:
        tree = ET.fromstring(text)  # noqa: S314 entities are refused above
    except ET.ParseError as wrong:
        raise BadInput(f"{source}: is not well-formed XML: {wrong}") from None
    if tree.tag != "robot":
        raise BadInput(f"{source}: the outermost element is <{tree.tag}>; expected <robot>")
    bodies = _chain(tree, source)
    if not 1 <= len(bodies) <= MAX_JOINTS:
        raise BadInput(f"{source}: has {len(bodies)} revolute or continuous joints in a row; expected 1 to {MAX_JOINTS}")
    drives = drives_of(tree, [body.joint for body in bodies], source)
    return replace(_in_dh_frames(tree.get("name") or "urdf", bodies), gear_ratio=drives.gear_ratio, coupling=drives.coupling)


# --- reading --------------------------------------------------------------------------------------------------------------


def _tree(tree: ET.Element, source: str) -> tuple[dict[str, ET.Element], dict[str, list[ET.Element]], str]:
    """Links by name, joints by parent link, and the name of the base link.

    Raises BadInput where a name stands twice, a joint's link does not exist, a link has two parents, or there is not one base.
    """
    named = [(_named(link, source), link) for link in tree.findall("link")]
    links = dict(named)
    if len(links) != len(named):
        twice = next(name for name in links if sum(name == other for other, _ in named) > 1)
        raise BadInput(f"{source}: link {twice!r} stands there twice; expected every name once")
    joints: dict[str, list[ET.Element]] = {}
    children = set()
    for joint in tree.findall("joint"):
        name = _named(joint, source)
        ends = []
        for role in ("parent", "child"):
            end = joint.find(role)
            link = None if end is None else end.get("link")
            if link not in links:
                raise BadInput(f"{source}: joint {name!r}: its {role} link {link!r} does not exist")
            ends.append(link)
        if ends[1] in children:
            raise BadInput(f"{source}: link {ends[1]!r} hangs on two joints; expected a chain")
        if joint.find("mimic") is not None:
            raise BadInput(f"{source}: joint {name!r} mimics another; expected joints that move by themselves")
        children.add(ends[1])
        joints.setdefault(ends[0], []).append(joint)
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise BadInput(f"{source}: {len(roots)} links are nobody's child ({', '.join(roots) or 'none'}); expected one, the base")
    return links, joints, roots[0]


def _chain(tree: ET.Element, source: str) -> list[_Body]:
    """The moving bodies, from the base outward. Raises BadInput where links and joints are not one chain."""
    links, joints, root = _tree(tree, source)
    bodies: list[_Body] = []
    reached: set[str] = set()
    at: tuple[str, Array, Array] | None = (root, np.eye(3), np.zeros(3))
    while at is not None:
        moving: list[tuple[ET.Element, Array, Array]] = []
        fixed = [at]  # this link, and all links that fixed joints attach to it
        while fixed:
            name, R, p = fixed.pop()
            reached.add(name)
            if bodies:
                _add_inertia(bodies[-1], links[name], R, p, source)
            for joint in joints.get(name, []):
                turn, shift = _origin(joint, source)
                there = (R @ turn, p + R @ shift)
                kind = joint.get("type")
                if kind == "fixed":
                    fixed.append((_child(joint), *there))
                elif kind in {"revolute", "continuous"}:
                    moving.append((joint, *there))
                else:
                    raise BadInput(f"{source}: joint {joint.get('name')!r} is {kind}; expected revolute, continuous or fixed")
        if len(moving) > 1:
            names = ", ".join(repr(joint.get("name")) for joint, _, _ in moving)
            raise BadInput(f"{source}: after link {at[0]!r} the arm branches into joints {names}; expected one chain: remove the hand")
        at = None
        for joint, R, p in moving:
            axis = _numbers(joint.find("axis"), "xyz", "1 0 0", source, str(joint.get("name")))
            length = np.linalg.norm(axis)
            if length < 1e-9:
                raise BadInput(f"{source}: joint {joint.get('name')!r}: its axis is zero; expected a direction")
            limits = {key: _limit(joint, key, source) for key in ("lower", "upper", "effort", "velocity")}
            bodies.append(_Body(_child(joint), joint.get("name", ""), p, R @ axis / length, limits))
            at = (_child(joint), R, p)
    if lost := set(links) - reached:
        raise BadInput(
            f"{source}: the base does not lead to {', '.join(sorted(lost))}: their joints go round in a ring; expected one chain"
        )
    return bodies


def _named(element: ET.Element, source: str) -> str:
    """The element's name. Raises BadInput where it has none."""
    name = element.get("name")
    if not name:
        raise BadInput(f"{source}: a <{element.tag}> has no name")
    return name


def _child(joint: ET.Element) -> str:
    """The name of a joint's child link; `_tree` has checked that it exists."""
    child = joint.find("child")
    return "" if child is None else child.get("link", "")


def _numbers(element: ET.Element | None, key: str, default: str, source: str, where: str) -> Array:
    """The numbers of an attribute, or those of `default` without the element or attribute. Raises BadInput where they are no numbers."""
    text = default if element is None else element.get(key, default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != len(default.split()) or not np.all(np.abs(values) <= LARGEST):
        raise BadInput(f"{source}: {where}: {key} = {text!r}; expected {len(default.split())} finite numbers up to {LARGEST:g} in size")
    return values


def _origin(element: ET.Element, source: str) -> tuple[Array, Array]:
    """Rotation Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll) and translation of an element's <origin>."""
    origin, where = element.find("origin"), f"{element.tag} {element.get('name', '')!r}"
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0", source, where)
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    rotation = np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip
    return rotation, _numbers(origin, "xyz", "0 0 0", source, where)


def _add_inertia(body: _Body, link: ET.Element, R: Array, p: Array, source: str) -> None:
    """Add a link that lies at (R, p) in the base's frame. A link without <inertial> has no mass."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    where = f"link {link.get('name')!r}"
    mass = float(_numbers(inertial.find("mass"), "value", "0", source, where)[0])
    if mass < 0.0:
        raise BadInput(f"{source}: {where}: its mass is {mass:g} kg; expected 0 or more")
    turn, shift = _origin(inertial, source)
    tensor = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (float(_numbers(tensor, key, "0", source, where)[0]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if np.linalg.eigvalsh(J)[0] < -1e-6 * max(float(np.trace(J)), 1e-9):
        raise BadInput(f"{source}: {where}: its inertia has a negative principal moment: no body has one")
    axes = R @ turn
    com = p + R @ shift
    spread = axes @ (0.5 * np.trace(J) * np.eye(3) - J) @ axes.T  # ∫ x xᵀ dm about the centre of mass
    body.mass_kg += mass
    body.first_kg_m = body.first_kg_m + mass * com
    body.second_kg_m2 = body.second_kg_m2 + spread + mass * np.outer(com, com)


def _limit(joint: ET.Element, key: str, source: str) -> float:
    """The size of one limit of a joint; infinite where it is not given or does not apply. Raises BadInput where it is no number."""
    limit = joint.find("limit")
    text = None if limit is None else limit.get(key)
    if text is None or (joint.get("type") == "continuous" and key in {"lower", "upper"}):
        return math.inf
    try:
        value = abs(float(text))
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise BadInput(f"{source}: joint {joint.get('name')!r}: its limit {key} is {text!r}; expected a number")
    return value if value < UNLIMITED else math.inf


# --- frames ---------------------------------------------------------------------------------------------------------------


def _in_dh_frames(name: str, bodies: list[_Body]) -> Robot:
    """The robot whose links are the bodies, in standard DH frames."""
    axes = [body.axis for body in bodies]
    axes.append(axes[-1])  # frame J: no joint turns about it, so its z is that of frame J−1
    R = _first_frame(axes[0])
    o = bodies[0].origin - axes[0] * (axes[0] @ bodies[0].origin)  # the point of the axis nearest to the base's origin
    base = R
    J = len(bodies)
    a, y, d, alpha, zero = np.zeros((5, J))
    com, tensor = np.zeros((J, 3)), np.zeros((J, 3, 3))
    for i, body in enumerate(bodies):
        last = i == J - 1
        z, z_next = axes[i], axes[i + 1]
        x, origin = (R[:, 0], o) if last else _normal(R[:, 0], z, z_next, o, bodies[i + 1].origin)
        zero[i] = math.atan2(x @ R[:, 1], x @ R[:, 0])
        alpha[i] = math.atan2(np.cross(z, z_next) @ x, z @ z_next)
        step = origin - o
        a[i], y[i], d[i] = step @ x, step @ np.cross(z, x), step @ z
        R, o = np.column_stack([x, np.cross(z_next, x), z_next]), origin
        if body.mass_kg > 0.0:
            centre = body.first_kg_m / body.mass_kg
            com[i] = R.T @ (centre - o)
            second = R.T @ (body.second_kg_m2 - body.mass_kg * np.outer(centre, centre)) @ R
        else:
            second = R.T @ body.second_kg_m2 @ R
        tensor[i] = np.trace(second) * np.eye(3) - second
    # an offset of 1e-17 m is rounding
    a, y, d = (np.where(np.abs(v) < 1e-12, 0.0, v) for v in (a, y, d))
    unknown = np.full(J, np.nan)
    return Robot(
        name=name,
        generation="urdf",
        rate_hz=math.nan,
        link_names=tuple(body.name for body in bodies),
        a_m=a,
        d_m=d,
        alpha_rad=alpha,
        mass_kg=np.array([body.mass_kg for body in bodies]),
        com_m=com,
        inertia_kg_m2=tensor,
        gear_ratio=unknown,
        torque_constant_nm_per_a=unknown,
        max_torque_nm=np.array([body.limits["effort"] for body in bodies]),
        max_speed_rad_s=np.array([body.limits["velocity"] for body in bodies]),
        max_position_rad=np.array([max(body.limits["lower"], body.limits["upper"]) for body in bodies]),
        payload_max_kg=math.nan,
        zero_rad=zero,
        y_m=y,
        base_rotation=base,
    )


def _first_frame(z: Array) -> Array:
    """(3, 3) a frame whose z is the first joint's axis; the base's own frame where that axis is vertical."""
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - z * (z @ x)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _normal(x_before: Array, z: Array, z_next: Array, o: Array, on_next: Array) -> tuple[Array, Array]:
    """Direction x (3,) and origin (3,) of the frame on the next axis.

    For skew and crossing axes, x is along the common normal and the origin is its foot. For parallel axes every height is possible; the
    height of the frame before is taken. x_before : (3,) x of the frame before. z, z_next : (3,) the two axes. o : (3,) origin of the frame
    before. on_next : (3,) a point on the next axis.
    """
    across = np.cross(z, z_next)
    sine = float(np.linalg.norm(across))
    if sine > NEARLY_PARALLEL:
        x = across / sine
        # o + d·z + a·x = on_next + t·z_next, along z and z_next
        t = float(np.cross(on_next - o, z) @ across) / sine**2
        return (x if x @ x_before > -1e-9 else -x), on_next + t * z_next  # of the two directions the one with the smaller turn
    level = on_next + z_next * (float((o - on_next) @ z) / float(z_next @ z))  # the point of the next axis at the height of o
    apart = level - o
    distance = float(np.linalg.norm(apart))
    if sine > PARALLEL:
        x = across / sine
        x = x - z * (z @ x)  # the cross product of nearly equal vectors is perpendicular only to 1e-16/sine
        return x / np.linalg.norm(x), level
    return (apart / distance if distance > 1e-9 else x_before), level


# --- writing --------------------------------------------------------------------------------------------------------------


def urdf_text(robot: Robot, coulomb_nm: Array | None = None, viscous_nm_s_per_rad: Array | None = None) -> str:
    """The arm as a URDF: kinematics, inertias, limits, and friction as <dynamics> where both arrays (J,) are given.

    A URDF cannot hold rotor inertia: set it as the armature in the program that loads the file. The mounting is that program's gravity.
    """
    root = ET.Element("robot", name=robot.name)
    ET.SubElement(root, "link", name="base")
    links = [name if robot.link_names.count(name) == 1 and name != "base" else f"{name}_{i + 1}" for i, name in enumerate(robot.link_names)]
    base = robot.base_rotation
    R, p = base @ _turn_z(robot.zero_rad[0]), np.zeros(3)
    for i, link in enumerate(links):
        body = ET.SubElement(root, "link", name=link)
        to_dh = _turn_x(robot.alpha_rad[i])  # DH frame i in link frame i
        shift = np.array([robot.a_m[i], robot.y_m[i], robot.d_m[i]])
        J = to_dh @ robot.inertia_kg_m2[i] @ to_dh.T
        inertial = ET.SubElement(body, "inertial")
        ET.SubElement(inertial, "origin", xyz=_spelled(shift + to_dh @ robot.com_m[i]), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=repr(float(robot.mass_kg[i])))
        entries = {"ixx": J[0, 0], "ixy": J[0, 1], "ixz": J[0, 2], "iyy": J[1, 1], "iyz": J[1, 2], "izz": J[2, 2]}
        ET.SubElement(inertial, "inertia", {key: repr(float(value)) for key, value in entries.items()})

        endless = not math.isfinite(robot.max_position_rad[i])
        joint = ET.SubElement(root, "joint", name=f"joint_{i + 1}", type="continuous" if endless else "revolute")
        ET.SubElement(joint, "parent", link=links[i - 1] if i else "base")
        ET.SubElement(joint, "child", link=link)
        ET.SubElement(joint, "origin", xyz=_spelled(p), rpy=_spelled(_roll_pitch_yaw(R)))
        ET.SubElement(joint, "axis", xyz="0 0 1")
        limit = {"effort": _bounded(robot.max_torque_nm[i]), "velocity": _bounded(robot.max_speed_rad_s[i])}
        if not endless:
            reach = repr(float(robot.max_position_rad[i]))
            limit |= {"lower": f"-{reach}", "upper": reach}
        ET.SubElement(joint, "limit", limit)
        if coulomb_nm is not None and viscous_nm_s_per_rad is not None:
            ET.SubElement(joint, "dynamics", damping=repr(float(viscous_nm_s_per_rad[i])), friction=repr(float(coulomb_nm[i])))
        if i + 1 < robot.joints:
            R, p = to_dh @ _turn_z(robot.zero_rad[i + 1]), shift
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _spelled(values: Array) -> str:
    """The numbers as text; repr is the shortest text that reads back as the same number."""
    return " ".join(repr(float(value)) for value in values)


def _bounded(value: float) -> str:
    """A limit as text; `UNLIMITED` for an unknown one."""
    return repr(float(value)) if math.isfinite(value) else repr(UNLIMITED)


def _turn_z(angle: float) -> Array:
    """(3, 3) Rot(z, angle)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _turn_x(angle: float) -> Array:
    """(3, 3) Rot(x, angle)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _roll_pitch_yaw(R: Array) -> Array:
    """(3,) with R = Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll). Where the pitch is ±90° the yaw is zero."""
    upright = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], upright)
    if upright < 1e-9:
        return np.array([math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])

# SPDX-License-Identifier: BSD-3-Clause
"""Meshes of plain solids for OBJ files. Metres, z up; faces counter-clockwise from outside: others are not drawn."""

import numpy as np

_PLANE_AXES = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}


class Mesh:
    """Triangles with normals and texture coordinates, collected for one OBJ file.

    A patch is the part (u0, v0, u1, v1) of the texture that a face shows, v upwards, as Atlas.patch returns it.
    """

    def __init__(self):
        """Start empty."""
        self._corners = []

    def __len__(self):
        """Number of triangles."""
        return len(self._corners)

    def add_triangle(self, points_m, uv, normals=None):
        """Add a triangle (3, 3) with its uv (3, 2); flat unless normals (3, 3) are given. No area: left out."""
        points_m = np.asarray(points_m, dtype=float)
        normal = np.cross(points_m[1] - points_m[0], points_m[2] - points_m[0])
        length = np.linalg.norm(normal)
        if length < 1e-10:
            return
        normals = [normal / length] * 3 if normals is None else normals
        self._corners.append([(tuple(p), tuple(t), tuple(n)) for p, t, n in zip(points_m, uv, normals)])

    def add_quad(self, points_m, patch, normals=None):
        """Add a quad (4, 3), counter-clockwise from outside, textured with a patch: lower left corner first."""
        points_m = np.asarray(points_m, dtype=float)
        u0, v0, u1, v1 = patch
        uv = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
        if normals is None:
            normal = np.cross(points_m[1] - points_m[0], points_m[2] - points_m[0])
            normals = [normal / max(np.linalg.norm(normal), 1e-12)] * 4
        for triangle in ((0, 1, 2), (0, 2, 3)):
            self.add_triangle(*([values[i] for i in triangle] for values in (points_m, uv, normals)))

    def add_box(self, low_m, high_m, patch, skip="", faces=None):
        """Add an axis-aligned box.

        Args:
            low_m: corner (3,) with the smallest coordinates.
            high_m: corner (3,) with the largest.
            patch: patch of every face.
            skip: faces left out, letters of 'xXyYzZ': low and high side of each axis.
            faces: other patches by letter, such as {"X": picture}. Pictures stand upright and read from outside.
        """
        (x0, y0, z0), (x1, y1, z1) = low_m, high_m
        quads = {
            "x": [(x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1)],
            "X": [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
            "y": [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
            "Y": [(x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1)],
            "z": [(x0, y1, z0), (x1, y1, z0), (x1, y0, z0), (x0, y0, z0)],
            "Z": [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
        }
        for name, points in quads.items():
            if name not in skip:
                self.add_quad(points, (faces or {}).get(name, patch))

    def add_prism(self, outline_m, span_m, patch, axis="y", side_patch=None, skip=""):
        """Extrude a simple polygon along an axis.

        Args:
            outline_m: corners (n, 2) in either turn: (y, z) for axis x, (x, z) for axis y, (x, y) for axis z.
            span_m: low and high coordinate along the axis.
            patch: patch of both end faces; the outline's bounding box fills it, first coordinate along u on both ends.
            axis: 'x', 'y' or 'z'.
            side_patch: patch of the sides, or a list with one for every edge (None leaves it out); default patch.
            skip: end faces left out, '0' the low and '1' the high one.
        """
        outline = np.asarray(outline_m, dtype=float)
        count = len(outline)
        sides = list(side_patch) if isinstance(side_patch, list) else [side_patch or patch] * count
        ahead, following = outline, np.roll(outline, -1, axis=0)
        if np.sum(ahead[:, 0] * following[:, 1] - following[:, 0] * ahead[:, 1]) < 0:
            outline, sides = outline[::-1], [sides[(count - 2 - k) % count] for k in range(count)]
        low, high = (_to_3d(outline, at, axis) for at in span_m)
        # (x, z) turned counter-clockwise looks along +y, so for axis y the low end faces the reader.
        ends = ((low, "0"), (high, "1")) if axis == "y" else ((high, "1"), (low, "0"))
        size = np.ptp(outline, axis=0)
        uv = np.array(patch[:2]) + (outline - outline.min(axis=0)) / size * (np.array(patch[2:]) - patch[:2])
        for (corners, name), step in zip(ends, (1, -1)):
            if name not in skip:
                for triangle in triangulate(outline):
                    self.add_triangle(corners[list(triangle)[::step]], uv[list(triangle)[::step]])
        near, far = ends[0][0], ends[1][0]
        for k, side in enumerate(sides):
            if side is not None:
                other = (k + 1) % count
                self.add_quad([far[k], far[other], near[other], near[k]], side)

    def add_beam(self, start_m, end_m, section_m, patch, caps=True):
        """Add a straight bar from start to end; section_m is (width across, in the horizontal, and the other width)."""
        start, end = np.asarray(start_m, dtype=float), np.asarray(end_m, dtype=float)
        along = (end - start) / np.linalg.norm(end - start)
        across = np.cross((1.0, 0.0, 0.0) if abs(along[2]) > 0.999 else (0.0, 0.0, 1.0), along)
        across *= 0.5 * section_m[0] / np.linalg.norm(across)
        other = np.cross(along, across)
        other *= 0.5 * section_m[1] / np.linalg.norm(other)
        near = [start - across - other, start + across - other, start + across + other, start - across + other]
        far = [point + (end - start) for point in near]
        for end in (near[::-1], far) if caps else ():
            self.add_quad(end, patch)
        for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
            self.add_quad([near[a], near[b], far[b], far[a]], patch)

    def add_tube(self, path_m, radius_m, patch, sides=6, caps=True):
        """Sweep a round section along a path (n, 3); radius_m is a number or one per point (0 makes a tip)."""
        path = np.asarray(path_m, dtype=float)
        radii = np.broadcast_to(np.asarray(radius_m, dtype=float), (len(path),))
        legs = np.diff(path, axis=0)
        legs /= np.linalg.norm(legs, axis=1)[:, None]
        tangents = np.concatenate([legs[:1], legs[:-1] + legs[1:], legs[-1:]])
        tangents /= np.linalg.norm(tangents, axis=1)[:, None]
        angle = 2 * np.pi * (np.arange(sides + 1) + 0.5) / sides
        right = np.cross(tangents[0], (1.0, 0.0, 0.0) if abs(tangents[0][2]) > 0.9 else (0.0, 0.0, 1.0))
        rings, normals, before = [], [], tangents[0]
        for point, tangent, radius in zip(path, tangents, radii):
            # turned from one tangent t to the next t' the shortest way: r' = r - (r . t') / (1 + t . t') (t + t')
            right = right - (before + tangent) * (right @ tangent) / (1.0 + before @ tangent)
            right, before = right / np.linalg.norm(right), tangent
            around = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * np.cross(tangent, right)
            rings.append(point + radius * around)
            normals.append(around)
        for k in range(len(path) - 1):
            self._add_band(rings[k : k + 2], normals[k : k + 2], patch)
        if caps:
            for ring, step in ((rings[0][:-1][::-1], 0), (rings[-1][:-1], -1)):
                if radii[step] > 0:
                    self.add_fan(ring, patch)

    def add_fan(self, points_m, patch):
        """Add a flat convex polygon (n, 3), counter-clockwise from outside, in the colour of the patch's middle."""
        middle = [((patch[0] + patch[2]) / 2, (patch[1] + patch[3]) / 2)] * 3
        for k in range(1, len(points_m) - 1):
            self.add_triangle([points_m[0], points_m[k], points_m[k + 1]], middle)

    def add_lathe(self, profile_m, patch, sides=10, axis="z", offset_m=(0.0, 0.0, 0.0)):
        """Turn a profile of (radius, height) about an axis; (0, 0), (r, 0), (r, h), (0, h) is a cylinder.

        u runs once around, v along each leg. patch may be a list with one for every leg of the profile; None: left out.
        """
        profile = np.asarray(profile_m, dtype=float)
        patches = patch if isinstance(patch, list) else [patch] * (len(profile) - 1)
        angle = 2 * np.pi * np.arange(sides + 1) / sides
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides + 1)], axis=1)
        shift = {"x": 1, "y": 2, "z": 0}[axis]  # cyclic: z becomes x or y, the turn stays
        up = np.array([0.0, 0.0, 1.0])
        for (r0, h0), (r1, h1), part in zip(profile[:-1], profile[1:], patches):
            slope = np.array([h1 - h0, r0 - r1]) / max(np.hypot(h1 - h0, r0 - r1), 1e-12)
            normals = np.roll(slope[0] * circle + slope[1] * up, shift, axis=1)
            rings = [np.roll(r * circle + h * up, shift, axis=1) + offset_m for r, h in ((r0, h0), (r1, h1))]
            if part is not None:
                self._add_band(rings, [normals, normals], part)

    def add_ball(self, centre_m, radii_m, patch, sides=8, rings=5):
        """Add an ellipsoid with radii (3,) along x, y, z; u runs around from +x, v from bottom to top."""
        radii = np.broadcast_to(np.asarray(radii_m, dtype=float), (3,))
        u0, v0, u1, v1 = patch
        angle = 2 * np.pi * np.arange(sides + 1) / sides
        layers = []
        for height in -np.pi / 2 + np.pi * np.arange(rings + 1) / rings:
            unit = np.stack([np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle)], axis=1)
            layers.append(np.column_stack([unit, np.full(sides + 1, np.sin(height))]))
        for k in range(rings):
            points = [layer * radii + np.asarray(centre_m) for layer in layers[k : k + 2]]
            normals = [layer / radii for layer in layers[k : k + 2]]
            normals = [n / np.linalg.norm(n, axis=1)[:, None] for n in normals]
            part = (u0, v0 + (v1 - v0) * k / rings, u1, v0 + (v1 - v0) * (k + 1) / rings)
            self._add_band(points, normals, part)

    def add_mesh(self, other, offset_m=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0), scale=1.0):
        """Add a copy of another Mesh: scaled, turned about the fixed axes x, y, z in this order, then moved."""
        turn = rotation(turn_rad)
        for triangle in other._corners:
            points, uv, normals = zip(*triangle)
            points = np.asarray(points) * scale @ turn.T + np.asarray(offset_m)
            self.add_triangle(points, uv, np.asarray(normals) @ turn.T)

    def fit(self, size_m):
        """Scale and move so that the bounding box is size_m (3,) with its bottom centre at the origin."""
        points = np.array([point for triangle in self._corners for point, _, _ in triangle])
        low, high = points.min(axis=0), points.max(axis=0)
        scale = np.asarray(size_m) / (high - low)
        origin = np.array([*(low + high)[:2] / 2, low[2]])
        triangles, self._corners = self._corners, []
        for triangle in triangles:
            points, uv, normals = (np.asarray(values) for values in zip(*triangle))
            normals = normals / scale
            self.add_triangle((points - origin) * scale, uv, normals / np.linalg.norm(normals, axis=1)[:, None])

    def _add_band(self, rings, normals, patch):
        """Quads between two rings (n, 3) that turn counter-clockwise seen from beyond the second."""
        u0, v0, u1, v1 = patch
        u = np.linspace(u0, u1, len(rings[0]))
        for a in range(len(u) - 1):
            b = a + 1
            corners = [(0, a, v0), (0, b, v0), (1, b, v1), (1, a, v1)]
            for triangle in ((0, 1, 2), (0, 2, 3)):
                chosen = [corners[i] for i in triangle]
                self.add_triangle(
                    [rings[r][i] for r, i, _ in chosen],
                    [(u[i], v) for _, i, v in chosen],
                    [normals[r][i] for r, i, _ in chosen],
                )

    def write(self, folder, name, texture):
        """Write NAME.obj and NAME.mtl, with the texture given relative to the folder."""
        tables = [{}, {}, {}]
        faces = []
        for triangle in self._corners:
            keys = [[np.round(value, 5) + 0.0 for value in corner] for corner in triangle]
            refs = ["/".join(str(t.setdefault(tuple(k), len(t) + 1)) for t, k in zip(tables, key)) for key in keys]
            faces.append("f " + " ".join(refs))
        lines = [f"# Made by make_models.py. {len(faces)} triangles.", f"mtllib {name}.mtl", f"o {name}"]
        for tag, table in zip(("v", "vt", "vn"), tables):
            lines += [f"{tag} " + " ".join(f"{x:g}" for x in row) for row in table]
        lines += [f"usemtl {name}", *faces]
        (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
        material = f"newmtl {name}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {texture}\n"
        (folder / f"{name}.mtl").write_text("# Made by make_models.py.\n" + material)


def rotation(turn_rad):
    """Rotation matrix (3, 3) about the fixed axes x, y, z in this order: R = Rz Ry Rx."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(turn_rad), np.sin(turn_rad)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def triangulate(outline):
    """Triples of corner indices that fill a simple counter-clockwise polygon (n, 2), by cutting off ears."""
    left, triangles = list(range(len(outline))), []

    def cross(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = outline[a], outline[b], outline[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    while len(left) > 2:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            others = (p for p in left if p not in (a, b, c))
            inside = any(min(cross(a, b, p), cross(b, c, p), cross(c, a, p)) >= 0 for p in others)
            if cross(a, b, c) >= 0 and not inside:
                triangles.append((a, b, c))
                del left[k]
                break
        else:
            raise ValueError("the outline crosses itself")
    return triangles


def _to_3d(outline, at, axis):
    points = np.full((len(outline), 3), float(at))
    points[:, _PLANE_AXES[axis]] = outline
    return points

"""OBJ files as Tilery reads them: triangles with the format's winding rule.

Only what the scenes of the comparison use: v, vt, vn, f with positive or negative indices. A face
of more than three corners is cut as a fan, so it must be convex.
"""
import numpy as np


def _corner(text, counts):
    parts = (text.split("/") + ["", ""])[:3]
    return tuple(None if p == "" else int(p) - 1 if int(p) > 0 else counts[i] + int(p)
                 for i, p in enumerate(parts))


def _lines(path):
    tables = {"v": [], "vt": [], "vn": []}
    faces = []
    for line in open(path, encoding="utf-8"):
        words = line.split("#")[0].split()
        if words and words[0] in tables:
            size = 2 if words[0] == "vt" else 3
            tables[words[0]].append([float(w) for w in words[1:1 + size]])
        elif words and words[0] == "f":
            counts = [len(tables[k]) for k in ("v", "vt", "vn")]
            corners = [_corner(w, counts) for w in words[1:]]
            faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
    return tables, faces


def read(path, transform):
    """(positions, normals or None, uvs or None), one row a corner, after `transform` (4x4)."""
    read_tables, faces = _lines(path)
    corners = [c for face in faces for c in face]

    def column(which, key, width):
        if not corners or any(c[which] is None for c in corners):
            return None
        return np.array([read_tables[key][c[which]] for c in corners], dtype=float).reshape(-1, width)

    matrix = np.asarray(transform, dtype=float).reshape(4, 4)
    linear = matrix[:3, :3]
    points = column(0, "v", 3) @ linear.T + matrix[:3, 3]
    normals, uvs = column(2, "vn", 3), column(1, "vt", 2)
    if normals is not None:
        normals = normals @ np.linalg.inv(linear)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # A face keeps its side: that of its normals, or of its file where a transform mirrors it.
    mirrored = np.linalg.det(linear) < 0
    tables = [t for t in (points, normals, uvs) if t is not None]
    for face in range(0, len(points), 3):
        a, b, c = points[face:face + 3]
        if mirrored if normals is None else np.dot(np.cross(b - a, c - a), normals[face]) < 0:
            for table in tables:
                table[[face + 1, face + 2]] = table[[face + 2, face + 1]]
    return points, normals, uvs

"""cloud.py CLOUD.ply: what other programs read in a cloud, as JSON: `plyfile`, `trimesh`, and MeshLab itself
by `pymeshlab`, each left out where it is not installed; "skipped" where none is."""
import json
import sys


def figures(xyz, grey=None, quality=None):
    """Count, mean position, mean grey (0 to 255) and mean quality."""
    mean = lambda values: None if values is None else float(values.mean())
    return {"points": len(xyz), "mean_mm": [float(v) for v in xyz.astype(float).mean(0)],
            "grey": mean(grey), "quality": mean(quality)}


def by_plyfile(path):
    import numpy
    from plyfile import PlyData
    v = PlyData.read(path)["vertex"]
    xyz = numpy.stack([v["x"], v["y"], v["z"]], 1)
    return figures(xyz, 255 * v["intensity"], v["quality"])


def by_trimesh(path):
    import trimesh
    cloud = trimesh.load(path)
    return figures(cloud.vertices)


def by_meshlab(path):
    import pymeshlab
    all = pymeshlab.MeshSet()
    all.load_new_mesh(path)
    cloud = all.current_mesh()
    grey = 255 * cloud.vertex_color_matrix()[:, 0]
    return figures(cloud.vertex_matrix(), grey, cloud.vertex_scalar_array())


found = {}
for name, read in [("plyfile", by_plyfile), ("trimesh", by_trimesh), ("meshlab", by_meshlab)]:
    try:
        found[name] = read(sys.argv[1])
    except ImportError:
        pass
print(json.dumps(found) if found else "skipped")

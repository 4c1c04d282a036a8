"""Makes small RTAB-Map databases of every sort, as the versions write them."""

import sqlite3
import struct
from contextlib import closing
from dataclasses import dataclass

import cv2
import numpy as np

from ebjax.io.logs import rvl

K = np.array([[50.0, 0, 16], [0, 52, 12], [0, 0, 1]])
WIDTH, HEIGHT = 32, 24


def mount(pitch_deg=30.0, height_m=0.5, yaw_deg=0.0):
    """base_from_camera of a camera that looks `pitch_deg` below the horizon."""
    p, y = np.deg2rad([pitch_deg, yaw_deg])
    pose = np.eye(4)
    pose[:3, :3] = [[0, -np.sin(p), np.cos(p)], [-1, 0, 0], [0, -np.cos(p), -np.sin(p)]]
    pose[:3, :3] = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]]) @ pose[:3, :3]
    pose[:3, 3] = [0.2, 0.0, height_m]
    return pose


def planar(x, y=0.0, theta=0.0):
    pose = np.eye(4)
    pose[:2] = [[np.cos(theta), -np.sin(theta), 0, x], [np.sin(theta), np.cos(theta), 0, y]]
    return pose


def rows(pose):
    """48 bytes of a pose; null where None."""
    return np.zeros(12, "<f4").tobytes() if pose is None else pose[:3].astype("<f4").tobytes()


def model(k=K, d=(), r=None, p=None, base_from_camera=None, size=(WIDTH, HEIGHT), version=(0, 23, 8)):
    """A serialised camera, from 0.18.0 on."""
    parts = [np.zeros(0) if part is None else np.asarray(part, "<f8").reshape(-1) for part in (k, d, r, p)]
    transform = b"" if base_from_camera is None else rows(base_from_camera)
    header = struct.pack("<11i", *version, 0, *size, *(len(part) for part in parts), len(transform) // 4)
    return header + b"".join(part.astype("<f8").tobytes() for part in parts) + transform


def stereo(left, right, version=(0, 23, 8)):
    """A serialised stereo pair."""
    header = struct.pack("<10i", *version, 1, 9, 3, 0, 0, len(left), len(right))
    return header + np.eye(3).tobytes() + np.array([-0.1, 0, 0]).tobytes() + left + right


def old_model(base_from_camera, baseline=None):
    """A camera before 0.18.0, a row of float32."""
    head = [50, 52, 16, 12, *([] if baseline is None else [baseline]), WIDTH, HEIGHT]
    return np.array([*head, *base_from_camera[:3].reshape(-1)], "<f4").tobytes()


def png(value, width=WIDTH, height=HEIGHT):
    return cv2.imencode(".png", np.full((height, width, 3), value, np.uint8))[1].tobytes()


def depth_mm(value=1500):
    """Millimetres with a missing pixel, and one of 65535."""
    depth = np.full((HEIGHT, WIDTH), value, np.uint16)
    depth[0, :2] = 0, 65535
    return depth


def depth_rvl(depth):
    return b"DEPTHRVL" + struct.pack("<2I", depth.shape[1], depth.shape[0]) + rvl.encode(depth)


def depth_png(depth):
    return cv2.imencode(".png", depth)[1].tobytes()


def depth_float(depth_m):
    return cv2.imencode(".png", depth_m.astype("<f4").view(np.uint8).reshape(*depth_m.shape, 4))[1].tobytes()


@dataclass
class Node:
    id: int
    session: int = 0
    weight: int | None = 0
    stamp: float | None = None
    pose: np.ndarray | None = None
    truth: np.ndarray | None = None
    image: bytes | None = None
    depth: bytes | None = None
    calibration: bytes | None = None


def drive(count=5, first=1, **fields):
    """Nodes with a grey image, a pose 0.1 m on, and a stamp 1 s later each."""
    nodes = []
    for k in range(first, first + count):
        nodes.append(
            Node(k, stamp=100.0 + k, pose=planar(0.1 * k), image=png(10 * k % 250), calibration=model(p=None), **fields)
        )
    return nodes


@dataclass
class Link:
    start: int
    end: int
    kind: int = 0
    information: np.ndarray | None = None


def make_database(path, nodes, links=(), version="0.23.8", wal=False):
    """Writes a database with the columns of its version."""
    parts = tuple(map(int, version.split(".")))
    weights = "information_matrix BLOB" if parts >= (0, 13, 0) else "rot_variance FLOAT, trans_variance FLOAT"
    admin = "version TEXT, preview_image BLOB, "
    if parts >= (0, 17, 0):
        admin += "opt_cloud BLOB, opt_ids BLOB, opt_poses BLOB, opt_last_localization BLOB, opt_polygons_size INTEGER, "
        admin += "opt_polygons BLOB, opt_tex_coords BLOB, opt_tex_materials BLOB, opt_map BLOB, opt_map_x_min FLOAT, "
        admin += "opt_map_y_min FLOAT, opt_map_resolution FLOAT, "
    schema = f"""
        CREATE TABLE Node(id INTEGER NOT NULL, map_id INTEGER NOT NULL, weight INTEGER, stamp FLOAT, pose BLOB,
            ground_truth_pose BLOB, label TEXT, time_enter DATE, PRIMARY KEY (id));
        CREATE TABLE Data(id INTEGER NOT NULL, image BLOB, depth BLOB, calibration BLOB, time_enter DATE,
            PRIMARY KEY (id));
        CREATE TABLE Link(from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, type INTEGER NOT NULL, {weights},
            transform BLOB, user_data BLOB);
        CREATE TABLE Info(parameters TEXT, time_enter DATE);
        CREATE TABLE Admin({admin} time_enter DATE);
        CREATE TRIGGER insert_Node_timeEnter AFTER INSERT ON Node
            BEGIN UPDATE Node SET time_enter = DATETIME('NOW') WHERE rowid = new.rowid; END;
    """
    with closing(sqlite3.connect(path)) as database:
        if wal:
            database.execute("PRAGMA journal_mode=WAL")
        database.executescript(schema)
        database.execute("INSERT INTO Admin(version) VALUES(?)", (version,))
        if parts >= (0, 17, 0):
            database.execute(
                "UPDATE Admin SET opt_ids=x'01', opt_poses=x'02', opt_last_localization=x'03', opt_map=x'04'"
            )
            database.execute("UPDATE Admin SET opt_map_x_min=-3.5, opt_map_resolution=0.05, opt_cloud=x'05'")
        for n in nodes:
            pose, truth = rows(n.pose), rows(n.truth)
            database.execute(
                "INSERT INTO Node(id, map_id, weight, stamp, pose, ground_truth_pose) VALUES(?, ?, ?, ?, ?, ?)",
                (n.id, n.session, n.weight, n.stamp, pose, truth),
            )
            database.execute(
                "INSERT INTO Data(id, image, depth, calibration) VALUES(?, ?, ?, ?)",
                (n.id, n.image, n.depth, n.calibration),
            )
        columns = "from_id, to_id, type, transform" + (", information_matrix" if parts >= (0, 13, 0) else "")
        for link in links:
            values = [link.start, link.end, link.kind, rows(planar(0.1))]
            if parts >= (0, 13, 0):
                values.append((100 * np.eye(6) if link.information is None else link.information).tobytes())
            database.execute(f"INSERT INTO Link({columns}) VALUES({', '.join('?' * len(values))})", values)
        database.commit()
    return path

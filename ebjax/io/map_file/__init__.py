"""The map's file: one SQLite database (suffix .ebmap) that outlasts the runs that write it.

What holds for other readers, in version 1 (`PRAGMA application_id` 0x45426d70 "EBmp", `user_version` 1):

    map(id, facts, crc)                              one row; JSON: what must agree with whoever goes on
    sessions(id, name, started, finished, facts, crc)        started: ISO 8601; facts: JSON
    keyframes(id, session, frame, stamp_s, name, pose, crc)  pose: as it was when the keyframe was added
    frames(id, frame, stamp_s, name, keyframe, keyframe_from_base, crc)  the images between keyframes
    edges(id, kind, i, j, opposing, kept, reason, i_from_j, covariance, inliers, matches, distance, has_arrays, crc)
    settled(id, poses, crc)                          block id: poses of keyframes 256 id to 256 id + 255 as last solved
    keyframe_arrays(id, packed, crc)                 id: the keyframe's
    edge_arrays(id, packed, crc)                     id: the edge's; a row where has_arrays is 1
    state(id, session, name, packed, crc)            named arrays of a session; session 0: of the map
    counts(id, sessions, keyframes, frames, edges, settled, state, crc)  one row: how many rows each of these has

Poses are x, y (m) and heading (rad), little-endian float64, in blobs, because a REAL column loses the sign of zero;
base in the map for keyframes, `a_from_b` elsewhere. A covariance is 3 x 3, row by row. A settled pose of NaN is none:
the keyframe's own holds. `packed` is as `packed.py` says. A NULL `distance` is NaN.

SQLite's pages carry no checksum, so that every row has one: `crc` is the CRC-32 of the JSON list of the table's name
and the row's values without blobs, as Python's `json.dumps` writes it, continued over the blobs in their order.

While a writer has the file, FILE-wal and FILE-shm beside it belong to it, and FILE.lock names its process. A file whose
writer was killed still has its FILE-wal: move and copy the two together.
"""

"""Columns by name, as programs write them."""

import numpy as np
import pytest

from ebjax.io.pose_table.names import meaning

TUM = "t x y z qx qy qz qw"
HEADERS = {
    "TUM": ("# timestamp tx ty tz qx qy qz qw", TUM, " "),
    "w first": ("# timestamp tx ty tz qw qx qy qz", "t x y z qw qx qy qz", " "),
    "a remark behind": ("# timestamp(frame/30) tx ty tz qx qy qz qw  camera-to-world", TUM, " "),
    "RTAB-Map 11": ("#timestamp x y z qx qy qz qw id", TUM + " n", " "),
    "number first": ("num,t,x,y,z,qx,qy,qz,qw", "n " + TUM, ","),
    "number, w first": ("num;t;x;y;z;qw;qx;qy;qz", "n t x y z qw qx qy qz", ";"),
    "UZH-FPV": ("# id timestamp tx ty tz qx qy qz qw", "n " + TUM, " "),
    "pandas": (",timestamp,tx,ty,tz,qx,qy,qz,qw", "n " + TUM, ","),
    "tabs, capitals": ("Time [s]\tPos X [m]\tPos Y [m]\tPos Z [m]\tQuat W\tQuat X\tQuat Y\tQuat Z",
                       "t x y z qw qx qy qz", "\t"),
    "AirSim": ("TimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile", "t x y z qw qx qy qz n", "\t"),
    "tabs, an index": ("\ttimestamp\ttx\tty\ttz\tqx\tqy\tqz\tqw", "n " + TUM, "\t"),
    "OpenVINS": ("# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pr13", TUM, " "),
    "Kimera": ("#timestamp,x,y,z,qw,qx,qy,qz,vx,vy,vz,bgx,bgy,bgz", "ns x y z qw qx qy qz 0 0 0 0 0 0", ","),
    "OKVIS": ("timestamp, p_WS_W_x, p_WS_W_y, p_WS_W_z, q_WS_x, q_WS_y, q_WS_z, q_WS_w, v_WS_W_x",
              "ns x y z qx qy qz qw 0", ", "),
    "PX4": ("timestamp_us,timestamp_sample_us,ref_timestamp,x,y,z,vx,vy,vz,heading", "us us 0 x y z 0 0 0 yaw", ","),
    "quoted": ('"timestamp","pose.position.x","pose.position.y","pose.position.z","pose.orientation.x",'
               '"pose.orientation.y","pose.orientation.z","pose.orientation.w"', TUM, ","),
    "quaternion before position": ("t,q_w,q_x,q_y,q_z,p_x,p_y,p_z", "t qw qx qy qz x y z", ","),
    "camel case": ("timeStamp,posX,posY,posZ,quatX,quatY,quatZ,quatW", TUM, ","),
    "EuRoC": ("#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
              "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
              "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]",
              "ns x y z qw qx qy qz" + " 0" * 9, ","),
    "TUM VI": ("#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []",
               "ns x y z qw qx qy qz", ","),
    "rostopic echo -p": (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
        + ",".join(f"field.pose.pose.position.{a}" for a in "xyz") + ","
        + ",".join(f"field.pose.pose.orientation.{a}" for a in "xyzw") + ",field.pose.covariance0,"
        + ",".join(f"field.twist.twist.{v}.{a}" for v in ("linear", "angular") for a in "xyz"),
        "0 n ns n x y z qx qy qz qw 0" + " 0" * 6, ","),
    "PlotJuggler": (
        "__time," + ",".join(f"/odom/pose/pose/orientation/{a}" for a in "wxyz") + ","
        + ",".join(f"/odom/pose/pose/position/{a}" for a in "xyz") + ",/odom/twist/twist/linear/x",
        "t qw qx qy qz x y z 0", ","),
    "rosbag_to_csv": ("rosbagTimestamp,seq,x,y,z,x,y,z,w", "ns n x y z qx qy qz qw", ","),
    "Euler": ("# timestamp x y z roll pitch yaw", "t x y z roll pitch yaw", " "),
    "Euler in any order": ("yaw_rad;pitch_rad;roll_rad;x_m;y_m;z_m;time_s", "yaw pitch roll x y z t", ";"),
    "planar": ("# timestamp x y theta", "t x y yaw", " "),
    "planar, degrees": ("t,x,y,yaw_deg", "t x y deg", ","),
    "planar, unwrapped": ("t,x,y,heading", "t x y unwrapped", ","),
    "planar, without times": ("# scan_index x y theta (m, rad), SLAM-corrected", "n x y yaw", " "),
    "planar, phi": ("x y phi", "x y yaw", " "),
    "no times": ("frame,tx,ty,tz,qx,qy,qz,qw", "n x y z qx qy qz qw", ","),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
def test_headers_are_obeyed(drive, reading, name):
    header, columns, separator = HEADERS[name]
    found = reading(drive.text(columns, separator, header))
    assert found.timed is ("without times" not in name and name not in ("planar, phi", "no times"))
    drive.check(found)


def test_what_is_left_out_and_reordered_is_said(drive, reading):
    header, columns, separator = HEADERS["number, w first"]
    found = reading(drive.text(columns, separator, header))
    assert any("poses.txt: columns that are no part of a pose are left out: num" in note for note in found.notes)
    assert any("written qw qx qy qz (header)" in note for note in found.notes)
    header, columns, separator = HEADERS["EuRoC"]
    notes = " ".join(reading(drive.text(columns, separator, header)).notes)
    assert "left out: v_RS_R_x [m s^-1]" not in notes and "and 5 more" in notes
    assert "stamps are nanoseconds (by their size), read as seconds" in notes
    assert reading(drive.text(TUM, " ", "# timestamp tx ty tz qx qy qz qw")).notes == ()


@pytest.mark.parametrize("unit, metres", [("mm", 0.001), ("cm", 0.01), ("m", 1.0)])
def test_positions_in_other_units(drive, reading, unit, metres):
    header = f"time [ms],x [{unit}],y [{unit}],z [{unit}],qx,qy,qz,qw"
    rows = [
        ",".join([f"{t * 1000:.3f}", *(f"{v / metres:.7f}" for v in p), *(f"{v:.9f}" for v in q)])
        for t, p, q in zip(drive.times, drive.positions, drive.rotations.as_quat(), strict=True)
    ]
    found = reading("\n".join([header, *rows]))
    drive.check(found)
    assert "stamps are milliseconds (header), read as seconds" in found.notes[0]
    assert (f"positions are in {unit} (header)" in " ".join(found.notes)) is (unit != "m")


PAIRS = ["t_sec,t_nsec", "secs,nsecs", "header.stamp.sec,header.stamp.nanosec", "Time_Secs,Time_NSecs", "sec,nanosec"]


@pytest.mark.parametrize("pair", PAIRS)
def test_seconds_and_nanoseconds(drive, reading, pair):
    rows = [
        f"{int(t)},{round(t % 1 * 1e9)}," + ",".join(f"{v:.9f}" for v in [*p, *q])
        for t, p, q in zip(drive.times, drive.positions, drive.rotations.as_quat(), strict=True)
    ]
    drive.check(reading(f"{pair},x,y,z,qx,qy,qz,qw\n" + "\n".join(rows)))


def test_the_messages_own_stamp_goes_before_its_receipt(drive, reading):
    columns = "0 t x y z qx qy qz qw"
    header = "Time,header.stamp,pose.position.x,pose.position.y,pose.position.z," + ",".join(
        f"pose.orientation.{a}" for a in "xyzw"
    )
    found = reading(drive.text(columns, ",", header))
    drive.check(found)
    assert "left out: Time" in found.notes[0]


@pytest.mark.parametrize(
    "header, columns, words",
    [
        ("# timestamp tx ty tz qx qy qz qw", TUM + " n", "line 1: 8 columns are named, but the rows have 9"),
        (
            "timestamp,tx,ty,tz,q0,q1,q2,q3",
            TUM,
            "line 1: no columns are named as the orientation .*names are timestamp",
        ),
        (
            "# timestamp tx ty tz q0 q1 q2 q3",
            TUM,
            "no columns are named as the orientation.*correct this line, or remove",
        ),
        ("t,a,b,c,qx,qy,qz,qw", TUM, r"no column is named as the position \(x, y or x, y, z\)"),
        ("t,x,y,z", "t x y z", "no columns are named as the orientation"),
        ("t,x [ft],y [ft],z [ft],qx,qy,qz,qw", TUM, "unit 'ft' is not known; convert the column to one of m, cm, mm"),
        ("timestamp [ticks],x,y,z,qx,qy,qz,qw", TUM, "unit 'ticks' is not known.*ms, us, ns"),
        ("t,x [mm],y [m],z [m],qx,qy,qz,qw", TUM, "in different units"),
        ("t,a.position.x,a.position.y,b.position.x,b.position.y,yaw", "t x y x y yaw", "may both be the position"),
        ("timestamp,time,x,y,yaw", "t t x y yaw", "timestamp and time may both be the time"),
        ("timestamp;x;y", "t x y yaw", "does not name the 4 columns"),
    ],
)
def test_headers_that_are_no_pose_are_refused(drive, reading, header, columns, words):
    with pytest.raises(ValueError, match=f"poses.txt.*{words}"):
        reading(drive.text(columns, "," if "#" not in header else " ", header))


def test_colmaps_poses_are_refused_by_name(reading):
    head = "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
    with pytest.raises(ValueError, match=r"poses.txt: it is COLMAP's list of images.*Invert each"):
        reading(head + "1 1 0 0 0 0.5 0 0 1 a.jpg\n10.5 20.5 -1\n2 1 0 0 0 0.7 0 0 1 b.jpg\n\n")


def test_the_remedy_works(drive, reading):
    """The refusal names a first line; it is obeyed, other columns by any other name."""
    drive.check(reading(drive.text(TUM + " 0 0", " ", "# timestamp tx ty tz qx qy qz qw - -")))
    drive.check(reading(drive.text("0 " + TUM, " ", "# nothing timestamp tx ty tz qx qy qz qw")))


def test_remarks_are_no_header(drive, reading):
    remarks = "# ground truth trajectory\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n# x y of the robot (base [link])"
    drive.check(reading(drive.text(TUM, " ", remarks)))


@pytest.mark.parametrize(
    "name, kind, part, unit",
    [
        ("p_RS_R_x [m]", "position", "x", "m"),
        ("q_RS_w []", "quaternion", "w", ""),
        ("b_w_RS_S_x [rad s^-1]", "other", "", ""),
        ("field.twist.twist.angular.z", "other", "", ""),
        ("pose.covariance.x", "other", "", ""),
        ("t_nsec", "time", "ns", "ns"),
        ("timestamp (us)", "time", "", "us"),
        ("Theta°", "angle", "theta", "deg"),
        ("yaw [°]", "angle", "yaw", "deg"),
        ("yaw_rate", "other", "", ""),
        ("TX", "position", "x", ""),
        ("z_cm", "axis", "z", "cm"),
        ("", "other", "", ""),
    ],
)
def test_names(name, kind, part, unit):
    found = meaning(name)
    assert (found.kind, found.part, found.unit) == (kind, part, unit)


def test_a_header_that_contradicts_the_path_is_obeyed_and_said(drive, reading):
    found = reading(drive.text("t x y z qw qx qy qz", " ", "# timestamp tx ty tz qx qy qz qw"))
    assert np.abs(found.poses[:, :3, :3] - drive.rotations.as_matrix()).max() > 1
    assert "its header puts w last, but read with w first the moving frame turns with its path" in found.notes[0]


@pytest.mark.parametrize("seed", range(12))
def test_columns_may_stand_in_any_order(hilly, reading, seed):
    rng = np.random.default_rng(seed)
    names = {"t": "stamp", "x": "tx", "y": "ty", "z": "tz", "qx": "qx", "qy": "qy", "qz": "qz", "qw": "qw"}
    names |= {"n": "number", "0": "vel_x"}
    order = [list(names)[k] for k in rng.permutation(len(names))]
    separator = ",; \t"[seed % 4]
    header = ("# " if seed % 2 else "") + separator.join(names[column] for column in order)
    hilly.check(reading(hilly.text(" ".join(order), separator, header)))

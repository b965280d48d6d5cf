"""What the paper publishes: its Tables I to V, shown beside measured figures and always marked as published.

Table I is on SemanticKITTI's labelled sequences, II to IV on 11 to 21. Compression rates are taken after dropping
movable points and losing points that collide in the range image; their base is taken to be 16 bytes a point.
Times come from a TITAN RTX. Fig. 8 and Fig. 9 are drawings without numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

# Table I: method, FPS, mIoU in percent, then IoU in percent by class of SEGMENTED.
SEGMENTED = (
    "car",
    "truck",
    "bicycle",
    "motorcycle",
    "other-vehicle",
    "person",
    "bicyclist",
    "motorcyclist",
    "road",
    "sidewalk",
    "parking",
    "other-ground",
)
SEGMENTATION: Mapping[str, tuple[float, ...]] = {
    "PointNet": (14.6, 14.92, 61.6, 0.1, 1.3, 0.3, 0.8, 0.2, 0.2, 0.0, 61.6, 35.7, 15.8, 1.4),
    "PointNet++": (20.1, 16.41, 53.7, 0.9, 1.9, 0.2, 0.2, 0.9, 1.0, 0.0, 72.0, 41.8, 18.7, 5.6),
    "SqueezeSeg": (72.6, 24.48, 68.8, 3.3, 16.0, 4.1, 3.6, 12.9, 13.1, 0.9, 85.4, 54.3, 26.9, 4.5),
    "SqueezeSegV2": (62.8, 34.53, 81.8, 13.4, 18.5, 17.9, 14.0, 20.1, 25.1, 3.9, 88.6, 67.6, 45.8, 17.7),
    "SqueezeSegV3": (5.8, 49.88, 92.5, 29.6, 38.7, 36.5, 33.0, 45.6, 46.2, 20.1, 91.7, 74.8, 63.4, 26.4),
    "RangeNet++": (14.9, 45.16, 91.4, 25.7, 25.7, 34.4, 23.0, 38.3, 38.8, 4.8, 91.8, 75.2, 65.0, 27.8),
    "FPS-Net": (20.8, 47.67, 91.1, 37.1, 48.6, 37.8, 30.0, 60.5, 57.8, 7.5, 91.1, 74.6, 61.9, 26.0),
    "PolarNet": (15.6, 46.10, 93.8, 22.9, 40.3, 30.1, 28.5, 43.2, 40.2, 5.6, 90.8, 74.4, 61.7, 21.7),
    "RandLA-Net": (15.1, 47.89, 94.2, 40.1, 26.0, 25.8, 38.9, 49.2, 48.2, 7.2, 90.7, 73.7, 60.3, 20.4),
    "SA-LPCC": (4.76, 55.24, 92.4, 68.8, 18.3, 55.9, 57.7, 22.8, 65.8, 65.3, 89.5, 57.5, 39.0, 29.9),
}

# Table II: CR in percent by sequence, SA-LPCC at 1 mm, 5 mm, 1 cm, then octree at the same.
ACCURACIES = (0.001, 0.005, 0.01)  # metres
RATES: Mapping[str, tuple[float, ...]] = {
    "11": (4.21, 3.25, 2.85, 30.01, 19.12, 9.31),
    "12": (4.74, 3.73, 3.26, 31.01, 20.43, 11.53),
    "13": (3.66, 2.84, 2.45, 33.56, 25.93, 8.92),
    "14": (4.51, 3.54, 3.10, 30.66, 20.08, 9.40),
    "15": (4.30, 3.36, 2.95, 34.18, 26.45, 9.88),
    "16": (3.96, 3.00, 2.58, 31.28, 20.53, 9.89),
    "17": (4.61, 4.24, 3.16, 30.49, 20.03, 11.18),
    "18": (3.96, 3.40, 2.53, 29.67, 18.84, 9.07),
    "19": (3.86, 3.24, 2.44, 31.67, 20.93, 10.48),
    "20": (3.81, 3.04, 2.45, 28.43, 18.71, 10.21),
    "21": (4.20, 3.54, 2.74, 26.39, 15.29, 10.56),
    "average": (4.16, 3.38, 2.77, 30.66, 20.57, 10.03),
}

# Table III: system, our baseline of that name (None: the paper's own), seconds a scan to encode and to decode.
TIMES: tuple[tuple[str, str | None, float, float], ...] = (
    ("SA-LPCC", None, 1.715, 1.160),
    ("PC-PNG", "png", 0.106, 0.036),
    ("PC-HEVC-Intra", "hevc_intra", 2.054, 0.038),
    ("PC-HEVC-Inter", "hevc_inter", 8.489, 0.037),
    ("Octree", "octree", 0.024, 0.009),
    ("Draco", "draco", 0.031, 0.010),
    ("TMC13", "tmc13", 0.649, 0.337),
    ("Feng's method", "feng", 0.019, 0.019),
    ("Sun's method", "sun", 27.12, 0.04),
)

# Table IV: seconds a scan by sequence; its columns, and the stages of ours that do the same.
PARTS: Mapping[str, str] = {
    "segmentation": "segment",
    "data processing": "ingest",
    "surface fitting": "ground_fit",
    "inference": "predict",
    "entropy coding": "residual_code",
    "decoder": "decode",
}
STAGE_TIMES: Mapping[str, tuple[float, ...]] = {
    "11": (0.171, 1.421, 0.253, 0.374, 1.096, 1.152),
    "12": (0.172, 1.416, 0.274, 0.342, 1.107, 1.163),
    "13": (0.174, 1.345, 0.264, 0.343, 1.078, 1.158),
    "14": (0.190, 1.362, 0.302, 0.340, 1.104, 1.153),
    "15": (0.169, 1.411, 0.257, 0.343, 1.111, 1.156),
    "16": (0.176, 1.439, 0.269, 0.340, 1.093, 1.176),
    "average": (0.175, 1.399, 0.270, 0.347, 1.098, 1.160),
}


class Registered(NamedTuple):
    """Table V, one cloud of one pair of sequence 20: rotation error in degrees, translation error in metres."""

    source: str
    target: str
    cloud: str
    rotation_deg: float
    translation_m: float


REGISTRATION: tuple[Registered, ...] = tuple(
    Registered(*pair, cloud, *errors)
    for pair, all_errors in (
        (("560", "561"), ((0.0716, 0.0034), (0.0742, 0.0286), (0.0741, 0.0034))),
        (("562", "563"), ((0.0409, 0.0013), (0.1400, 0.0385), (0.0700, 0.0044))),
        (("564", "565"), ((0.0432, 0.0041), (0.1139, 0.0311), (0.0563, 0.0140))),
    )
    for cloud, errors in zip(
        ("raw, without movables", "raw", "SA-LPCC, without movables"), all_errors, strict=True
    )
)

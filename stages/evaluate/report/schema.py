"""Arrow schemas of what the report is made of: what runs measure, and what other commands add to it.

``stage.run`` gives METRICS rows; ``pipeline`` gathers them, with TIMES and FAILURES, through
:func:`salpcc.stages.evaluate.report.record.record` under ``OUT/report/``; ``report.build`` reads only that folder (and
the sizes of the files in ``OUT/archives/``), so a report can be rebuilt without decoding anything again.
"""

from __future__ import annotations

import pyarrow as pa

VERSION = 11

# One row per scan, measured on what was decoded from the archive. A null in a measured column means that
# there was no source scan to compare with. Bytes are those of the scan's payload; framing is added later.
METRICS = pa.schema(
    [
        ("sequence", pa.string()),
        ("gop", pa.int32()),
        ("name", pa.string()),
        ("time", pa.uint64()),  # ns
        ("points_in", pa.int64()),
        ("points_kept", pa.int64()),
        ("points_dropped_movable", pa.int64()),
        ("points_decoded", pa.int64()),
        ("points_on_fallback", pa.int64()),
        ("points_bit_identical", pa.int64()),  # without any correction; null where a motion by time hides it
        ("movable", pa.string()),  # what became of what may move: layered, dropped, one layer
        ("points_movable", pa.int64()),  # of the movable layer, in the figures above and below, too
        ("bytes_movable", pa.int64()),
        ("bytes_geometry", pa.int64()),
        ("bytes_intensity", pa.int64()),
        ("bytes_classes", pa.int64()),
        ("bytes_side", pa.int64()),
        ("bytes_source", pa.int64()),  # of the recorded points, every field of a message
        ("points_compared", pa.int64()),
        ("max_error_m", pa.float64()),  # 3-D, point by point in file order
        ("max_axis_error_m", pa.float64()),  # largest of |dx|, |dy|, |dz|
        ("squared_error_m2", pa.float64()),  # sum over points_compared
        ("d_d_m2", pa.float64()),  # eq. (24), which sums squared distances (25)
        ("bit_exact", pa.bool_()),  # x, y, z and intensity, float32 bit for bit
        ("intensity_exact", pa.bool_()),
        ("decode_ms", pa.float64()),  # CPU
        ("motion", pa.list_(pa.float64())),  # v, w: metres and radians per turn; null where none is known
        ("checksum", pa.string()),  # of the payload of each layer
        ("laser_returns", pa.list_(pa.int32())),  # by laser
        ("laser_bits", pa.list_(pa.float32())),  # of the ranges of all its returns
        ("class_counts", pa.list_(pa.int64())),  # points of the source by class; null where none were found
        ("in_order", pa.bool_()),  # errors compared in file order; else to the nearest point both ways
        (
            "group_counts",
            pa.list_(pa.int64()),
        ),  # 21 x 3, class of the truth by row, predicted group by column
        ("class_confusion", pa.list_(pa.int64())),  # 21 x 21, truth by row, in the order of labels.CLASSES
        # A sample for the pictures, in the first scan of a sequence only.
        ("sample_points", pa.list_(pa.float32())),  # decoded x, y, z, flat
        ("sample_intensity", pa.list_(pa.float32())),
        ("sample_error_m", pa.list_(pa.float32())),
        ("sample_classes", pa.list_(pa.uint8())),
        ("sample_source", pa.list_(pa.int16())),  # of the source in centimetres, where both classes are known
        ("sample_truth", pa.list_(pa.uint8())),
        ("sample_predicted", pa.list_(pa.uint8())),  # dropped points included
    ]
)

# One row per stage and GOP. CPU time of the kernels on one core, compilation excluded.
TIMES = pa.schema(
    [
        ("sequence", pa.string()),
        ("gop", pa.int32()),
        ("stage", pa.string()),
        ("scans", pa.int32()),
        ("cpu_ms", pa.float64()),  # of the whole GOP
        ("wall_ms", pa.float64()),
    ]
)

# One row per scan (or file) that could not be processed.
FAILURES = pa.schema(
    [
        ("sequence", pa.string()),
        ("name", pa.string()),
        ("stage", pa.string()),
        ("file", pa.string()),
        ("message", pa.string()),
    ]
)

# One row per baseline, asked error and scan. max_error 0 asks for bit-exactness.
BASELINES = pa.schema(
    [
        ("baseline", pa.string()),
        ("sequence", pa.string()),
        ("name", pa.string()),
        ("max_error", pa.float64()),
        ("status", pa.string()),  # "ok", "not run: …" or "failed: …"
        ("in_order", pa.bool_()),  # errors compared in file order; else to the nearest neighbour both ways
        ("points_in", pa.int64()),
        ("points_decoded", pa.int64()),
        ("bytes_geometry", pa.int64()),
        ("bytes_total", pa.int64()),  # null where the codec does not carry intensity
        ("max_error_m", pa.float64()),
        ("max_axis_error_m", pa.float64()),
        ("squared_error_m2", pa.float64()),
        ("d_d_m2", pa.float64()),
        ("bit_exact", pa.bool_()),
        ("encode_ms", pa.float64()),
        ("decode_ms", pa.float64()),
        ("memory_mb", pa.float64()),  # resident, at most, above what was held before; null where unknown
    ]
)

# Table V: one row per pair of scans, cloud and method. Errors by eqs. (26) and (27), d_res = 1.
REGISTRATION = pa.schema(
    [
        ("sequence", pa.string()),
        ("source", pa.string()),  # scan names
        ("target", pa.string()),
        ("cloud", pa.string()),  # "source", or the codec that decoded it: "sensor", "paper", "draco", …
        ("max_error", pa.float64()),  # metres asked, 0 for bit-exact; null for source
        ("movable", pa.bool_()),  # whether movable points are in the cloud
        ("method", pa.string()),  # "point to point", "point to plane"
        ("rotation_deg", pa.float64()),
        ("translation_m", pa.float64()),
        ("bpp", pa.float64()),  # total; null for source
    ]
)

# One row per scan, map and method: the error of its pose in the map.
LOCALISATION = pa.schema(
    [
        ("sequence", pa.string()),
        ("scan", pa.string()),
        ("map", pa.string()),
        ("max_error", pa.float64()),  # metres asked of the archive, 0 for bit-exact
        ("movable", pa.bool_()),  # whether movable points are in the scan
        ("method", pa.string()),  # "point to point", "point to plane"
        ("rotation_deg", pa.float64()),  # null where the map, or the scan, has too little there
        ("translation_m", pa.float64()),
    ]
)

# One row per map and kind of truth. Accuracies and rates are parts of 1.
MAP_QUALITY = pa.schema(
    [
        ("sequence", pa.string()),
        ("scans", pa.int64()),
        ("cleaner", pa.string()),  # "none" is plain accumulation
        ("cloud", pa.string()),  # "source" or "decoded"
        ("truth", pa.string()),  # "moving" or "movable" (parked ones too)
        *((name, pa.float64()) for name in ("sa", "da", "aa", "pr", "rr", "f1")),
        ("points", pa.int64()),
        ("seconds", pa.float64()),
    ]
)

# Fig. 8: one row per sequence, lossless coder and input.
CODERS = pa.schema(
    [
        ("sequence", pa.string()),
        ("coder", pa.string()),
        ("settings", pa.string()),  # level, variant
        ("input", pa.string()),  # "residual", or "raw": the scans as they are
        ("max_error", pa.float64()),  # metres, of the residual
        ("points", pa.int64()),  # input points of the scans
        ("bytes_out", pa.int64()),
        ("encode_ms", pa.float64()),  # CPU, sum over the scans
        ("decode_ms", pa.float64()),
        ("status", pa.string()),  # "ok" or "not run: …"
    ]
)

# What leaving something out costs: every study is a table of its variants (rows) and measures (columns).
ABLATIONS = pa.schema(
    [
        ("study", pa.string()),  # title of the table
        ("sequence", pa.string()),
        ("variant", pa.string()),
        ("measure", pa.string()),  # heading of the column, with its unit
        ("value", pa.float64()),
    ]
)

# Pictures that other commands draw, such as those of a map (Fig. 10).
PICTURES = pa.schema(
    [
        ("figure", pa.string()),  # "fig7", "fig10"
        ("group", pa.string()),  # what is shown together: a sequence
        ("title", pa.string()),
        ("caption", pa.string()),
        ("png", pa.binary()),
    ]
)

"""A GOP of the paper profile decodes the same with another number of threads, and on a GPU."""

from collections.abc import Callable

import pytest
import torch

from salpcc.schemas.scan import Scan
from salpcc.stages.ground_fit.grid_planes import fit_ground
from salpcc.stages.ingest.paper_grid import row_elevations, scan_to_grid
from salpcc.stages.predict.paper.frames import predict_gop
from salpcc.stages.predict.paper.st_lstm import load_model, predictor
from salpcc.stages.residual_code.paper.grid_coder import decode_grids, encode_grid
from salpcc.stages.residual_code.paper.grid_streams import GridState

GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")


@pytest.mark.parametrize("where", ["two threads", pytest.param("cuda", marks=GPU)])
def test_decoded_elsewhere(
    make_scan: Callable[..., Scan], monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    scans = [make_scan(seed, stride=8, motion=None) for seed in range(2)]
    elevation = row_elevations([scan.points for scan in scans])
    sweeps = [scan_to_grid(scan, 0.01, elevation) for scan in scans]
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        models = GridState("context")
        payloads = [
            encode_grid(sweep, fit_ground(sweep), predicted, models).data
            for sweep, predicted in zip(sweeps, predict_gop(sweeps), strict=True)
        ]
        if where == "cuda":
            monkeypatch.setattr(predictor, "load_model", lambda: load_model(device="cuda"))
        else:
            torch.set_num_threads(2)
        decoded = list(decode_grids(payloads))
    finally:
        torch.set_num_threads(before)
    for sweep, back in zip(sweeps, decoded, strict=True):
        assert (back.level == sweep.level).all()

"""Run configuration: what is asked of a run, resolved and written beside its results."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from salpcc.schemas.work import Movable, ScanRef, digest_of

Profile = Literal["sensor", "paper"]
Labels = Literal["network", "given"]
Effort = Literal["fast", "default", "max"]
# Payloads hold a coder's number in this list, so new ones come last.
Coder = Literal[
    "context", "ppmd", "zstd", "lz4", "bzip2", "brotli", "lzma2", "deflate64", "lizard", "lz5"
]  # fmt: skip
GRID_ACCURACY = 0.001  # metres, where a run of the paper profile asks for none
UNBOUNDED = 2**31  # as the end of `frames`


class RunConfig(BaseModel):
    """Everything that decides what a run computes; nothing of where or how fast it runs.

    The coding half (:attr:`coding`) decides the archive bytes: its digest names shards and archives.
    The other fields choose the input and what is measured afterwards.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    source: str = "semantickitti"
    profile: Profile = "sensor"
    max_error: float | None = Field(
        None,
        gt=0,
        le=10,
        description="metres, 3-D; None is bit-exact. Profile paper: the quantisation step of ranges; None is 1 mm",
    )
    keep_movable: bool = Field(False, description="one layer; no network is asked what may move")
    drop_movable: bool = Field(False, description="leave out what may move, instead of a layer of its own")
    movable_max_error: float | None = Field(
        None, ge=0, le=10, description="metres, of the movable layer; 0 is bit-exact, None as max_error"
    )
    classes: bool = Field(False, description="store the classes that the network finds")
    labels: Labels = "network"
    side_files: bool = Field(
        True, description="keep .label files, and the small text files of a sequence's folder"
    )
    effort: Effort = "default"
    coder: Coder = Field("ppmd", description="of the residuals, profile paper")
    gop: int = Field(8, ge=1, le=256, description="scans per group of pictures")
    sensor: str = Field("hdl64e", description="name of a shipped sensor model, or a JSON file")
    sensor_digest: str = Field(
        "", description="digest of the model that the name stood for; filled in by the run"
    )
    weights: str = Field("small", description="of the segmentation network: a shipped width, or a file")
    weights_digest: str = Field("", description="digest of the weights; filled in by the run")
    several_scans: bool = Field(True, description="whether the scans of a GOP settle their classes together")
    frames: tuple[int, int] | None = Field(None, description="frame numbers, first and one past the last")
    columns: Literal[4, 5] = Field(4, description="float32 numbers a point in .bin files")
    topics: tuple[str, ...] = Field((), description="of point clouds in a log; none is all")
    baselines: tuple[str, ...] = ()
    device: Literal["cpu", "cuda"] = "cpu"

    @model_validator(mode="after")
    def _frames_ascend(self) -> RunConfig:
        if self.frames is not None and not 0 <= self.frames[0] < self.frames[1]:
            raise ValueError(f"frames {self.frames[0]}:{self.frames[1]} is empty")
        return self

    @model_validator(mode="after")
    def _one_way(self) -> RunConfig:
        if self.keep_movable and self.drop_movable:
            raise ValueError("--keep-movable and --drop-movable ask for opposite things; choose one")
        if self.movable_max_error is not None and self.movable != "layered":
            raise ValueError("--max-error movable=METRES is of a movable layer, and there is none")
        return self

    @property
    def movable(self) -> Movable:
        """What becomes of what may move; the paper's grid has no layers."""
        if self.keep_movable:
            return "one layer"
        return "dropped" if self.drop_movable or self.profile == "paper" else "layered"

    @property
    def movable_bound(self) -> float | None:
        """Metres, of the movable layer; None is bit-exact."""
        return self.max_error if self.movable_max_error is None else self.movable_max_error or None

    @property
    def largest_error(self) -> float:
        """Metres, the larger bound of the layers; 0 is bit-exact."""
        return max(self.max_error or 0.0, (self.movable == "layered" and self.movable_bound) or 0.0)

    @property
    def stores_classes(self) -> bool:
        """Whether the archive holds the class of each point; what may move is told by the layers."""
        return self.classes or self.labels == "given" or self.profile == "paper"

    @property
    def stores_labels(self) -> bool:
        """Whether the archive holds the ``.label`` files; the points of the paper's grid are no longer theirs."""
        return self.side_files and self.profile == "sensor"

    def reads_labels(self, ref: ScanRef) -> bool:
        """Tell whether what becomes of a scan depends on its ``.label`` file, or on there being none."""
        return self.labels == "given" or (self.stores_labels and ref.labels is not None)

    @property
    def uses_network(self) -> bool:
        """Whether the run asks the segmentation network: only what may move has to be known."""
        return self.labels == "network" and (not self.keep_movable or self.classes)

    @property
    def accuracy(self) -> float:
        """Metres per level of the paper profile's grid."""
        return self.max_error or GRID_ACCURACY

    @property
    def coding(self) -> dict[str, object]:
        """The fields that decide archive bytes, by name; stored in every archive."""
        skip = {"source", "frames", "topics", "baselines", "device", "sensor", "weights"}
        skip |= {"columns"} if self.columns == 4 else set()
        skip |= set() if self.uses_network else {"weights_digest", "several_scans"}
        skip |= {"side_files"} if self.side_files else set()
        skip |= {name for name in ("drop_movable", "movable_max_error", "classes") if not getattr(self, name)}
        skip |= {"effort"} if self.profile == "paper" else {"coder"}
        fields = {k: v for k, v in self.model_dump(mode="json").items() if k not in skip}
        return fields | ({"layers": ["static", "movable"]} if self.movable == "layered" else {})

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of :attr:`coding`."""
        return digest_of(self.coding)

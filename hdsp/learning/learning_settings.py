"""Settings of models, training and hardware. Importing this module imports no torch."""

from collections.abc import Mapping
from dataclasses import asdict, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from hdsp.base.errors import InputError
from hdsp.base.settings import (
    DISTINCT,
    Count,
    Name,
    Natural,
    NotNegative,
    Positive,
    Seed,
    Target,
    checked,
    fault,
    load_settings,
    one_of,
    or_target,
)
from hdsp.learning.architectures import known_architecture, network_class
from hdsp.robot.lattice import PATCH_CELLS, Residue

if TYPE_CHECKING:
    import torch

#: Input channels, and the distance in cells at which each reads heights (unevenness: in addition to its radius).
CHANNELS = {"height": 0, "edge": 1, "slope_x": 1, "slope_y": 1, "unknown": 0, "unevenness": 1}

Channel = Annotated[str, one_of(tuple(CHANNELS))]
#: Channels or features of a layer.
Width = Annotated[int, Field(ge=1, le=1024)]


@checked
class HeightEncoding:
    """Height encoding; a pure function of one patch (`hdsp.learning.encoding.encode`).

    Attributes:
        reference: zero level. ``base``: height of the cell under the base, so that a robot on a platform and a
            robot on the floor see the same. ``none``: the map's own zero (published treatment); a network can be
            evaluated densely only with ``none``.
        unknown: height in metres for unknown (NaN) cells, relative to the reference. None: unknown cells have no
            height; there ``edge`` is 1 and ``height`` is 0, and they add nothing to their neighbours' differences.
        clip: height range in metres. The published data reaches up to 1.5 m.
        scale: factor on the clipped heights.
        channels: network inputs. ``height``: heights treated as above. ``edge``: e / (e + edge_scale) in [0, 1), where
            e is the greatest height difference between a cell and its eight neighbours; detailed costs are built from
            e, so the network need not learn it. ``slope_x``, ``slope_y``: d / (abs(d) + edge_scale) in (-1, 1), with
            the height difference d between the two neighbours along an axis. ``unevenness``: log(1 + S), where S sums
            the greatest differences between footholds over all cells within ``unevenness_radius``, weighted by
            1 - distance / radius; foot costs consist of this sum. ``unknown``: 1 where the height is unknown.
        edge_scale: height difference in metres at which ``edge`` is one half.
        unevenness_radius: in cells.
        unevenness_contact: in cells; a foothold is as high as the highest ground this near.
    """

    reference: Literal["none", "base"] = "none"
    unknown: float | None = 1.5
    clip: tuple[float, float] = (-1.5, 1.5)
    scale: Positive = 1.0
    channels: Annotated[tuple[Channel, ...], Field(min_length=1)] = ("height",)
    edge_scale: Positive = 0.1
    unevenness_radius: Annotated[int, Field(ge=1, le=PATCH_CELLS)] = 12
    unevenness_contact: Annotated[int, Field(ge=0, le=PATCH_CELLS)] = 0

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.clip[0] < self.clip[1]:
            raise fault("clip", self.clip, "the smaller number first")
        return self

    def to_dict(self) -> dict[str, Any]:
        """Returns a plain mapping with the same keys."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}

    def is_local(self) -> bool:
        """Returns whether each encoded cell depends on its own height alone, independent of the patch around it."""
        return self.reference == "none" and self.channels == ("height",)

    def radius(self, channel: str) -> int:
        """Returns the distance in cells, along x or y, within which an encoded cell reads heights."""
        further = self.unevenness_radius - 1 + self.unevenness_contact
        return CHANNELS[channel] + (further if channel == "unevenness" else 0)


@checked
class ModelSettings:
    """Model settings, as in ``conf/model/*.yaml``.

    Attributes:
        architecture: name of an architecture, or ``module:class`` (`hdsp.learning.architectures`).
        initialisation: ``he``, or ``default`` for PyTorch's.
        encoding: height encoding.
        options: architecture options; missing keys keep their defaults.
    """

    architecture: Annotated[str, AfterValidator(known_architecture)] = "klamt2019"
    initialisation: Literal["he", "default"] = "he"
    encoding: HeightEncoding = field(default_factory=HeightEncoding)
    options: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Returns a plain mapping for ``build_network``, with all defaults written out."""
        options = asdict(self.checked_options())
        return {
            "architecture": self.architecture,
            "initialisation": self.initialisation,
            "encoding": self.encoding.to_dict(),
            "options": {key: list(value) if isinstance(value, tuple) else value for key, value in options.items()},
        }

    def checked_options(self) -> Any:
        """Returns the options as the settings class of the architecture; imports torch.

        Raises:
            InputError: an option is unknown or wrong.
        """
        return load_settings(network_class(self.architecture).Options, self.options, "model.options")


@checked
class BatchSettings:
    """Batching of tasks.

    Attributes:
        by: ``map``: all 22 goals of ``size`` maps, so the trunk runs once per map. ``task``: ``size`` single
            tasks, each with its own evaluation; the paper trains with ``task`` and size 1.
        size: maps or tasks per batch.
    """

    by: Literal["map", "task"] = "map"
    size: Count = 32


@checked
class OptimizerSettings:
    """Optimiser settings; the paper uses ``sgd`` with lr 1e-4 and momentum 0.9.

    Weight decay acts on matrices and kernels, not on biases and normalisations.
    """

    name: Literal["sgd", "adamw"] = "sgd"
    lr: NotNegative = 1e-4
    momentum: Annotated[float, Field(ge=0, lt=1)] = 0.9
    weight_decay: NotNegative = 0.0


@checked
class ScheduleSettings:
    """Learning rate schedule, stepped each batch.

    Attributes:
        name: ``constant``; ``cosine`` to zero; ``onecycle``: up during the first ``warmup`` share, then down to zero.
        warmup: share of all steps, between 0 and 1.
    """

    name: Literal["constant", "cosine", "onecycle"] = "constant"
    warmup: Annotated[float, Field(gt=0, lt=1)] = 0.2


@checked
class LossSettings:
    """Loss weights and their decay rule.

    Attributes:
        feasibility, cost: initial weights.
        rule: ``plateau`` (paper), ``published`` (script) or ``constant``.
        factor: divisor of a weight when the rule cuts it.
        patience: epochs that the rule waits, see `hdsp.learning.callbacks`.
    """

    feasibility: NotNegative = 1.0
    cost: NotNegative = 1.0
    rule: Literal["constant", "plateau", "published"] = "plateau"
    factor: Annotated[float, Field(gt=1)] = 5.0
    patience: Count = 3

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.feasibility == self.cost == 0:
            raise fault("cost", self.cost, "a positive weight beside feasibility: 0, or nothing is learned")
        return self


@checked
class SelectionSettings:
    """Selection of the epoch whose state is kept.

    Attributes:
        set: validation set that decides.
        metric: ``combined``: lowest (1 - feasibility accuracy) + cost error; or one of the two alone.
    """

    set: Name = "val"
    metric: Literal["combined", "feasibility_accuracy", "cost_error"] = "combined"

    def score(self, metrics: Mapping[str, float]) -> float:
        """Returns an epoch's score; lower is better."""
        from hdsp.learning.metrics import combined_score

        accuracy, error = metrics[f"feasibility_accuracy/{self.set}"], metrics[f"cost_error/{self.set}"]
        if self.metric == "feasibility_accuracy":
            return 1 - accuracy
        # Without tasks feasible for both, the cost error is NaN, and the state must not win.
        return combined_score(accuracy, error) if self.metric == "combined" else combined_score(1.0, error)


@checked
class LimitSettings:
    """Smaller trainings, to look for faults.

    Attributes:
        train, val: largest number of batches in an epoch, and in each validation set; None = all.
        overfit: ``pipeline.train`` passes this number of maps for training, and the same maps for selection; None =
            the splits as they are.
    """

    train: Count | None = None
    val: Count | None = None
    overfit: Count | None = None


#: Settings that a checkpoint's fingerprint holds only where they differ from these values.
LATER: dict[str, Any] = {
    "ema": None, "early_stopping": None, "initial": None, "accumulate": 1, "limits": LimitSettings(), "loss": None,
    "callbacks": {},
}  # fmt: skip


@checked
class TrainerSettings:
    """Trainer settings, as in ``conf/trainer/*.yaml``: all training inputs besides model and data.

    Attributes:
        epochs, seed, batch, optimizer, schedule, losses, selection, limits: see their classes. Optimiser and schedule
            may also be a ``_target_`` with its arguments: a function of parameter groups, of an optimiser and the
            number of steps (``hdsp.learning.training_parts``).
        accumulate: batches for one step of the optimiser.
        loss, callbacks, metrics: a ``_target_`` each, for ``TrainingParts``; a callback that is None is left out.
        mirror: random mirroring of maps on the robot's x axis. It is the only symmetry in the costs: backward driving
            differs from forward driving, and a quarter turn moves the feet.
        gradient_clip: largest gradient norm per step; None = no limit.
        ema: decay for the weight average that is evaluated and saved; None = the last weights.
        early_stopping: epochs without a better score before training ends; None = no early stop.
        checkpoint_minutes: time between checkpoints within an epoch.
        initial: folder with a saved abstraction of the same model, or of a footprint network that lacks nothing but
            ``foot_ways`` or their ``manoeuvres``; training starts from its weights. None = random weights.
        splits, val_splits: labelled splits that ``pipeline.train`` passes to ``train``.
        stream: whether ``pipeline.train`` passes split folders, from which a few shards at a time are in memory.
        stream_shards: shards whose maps are shuffled together in a streamed training.
        share, residues: ``pipeline.train`` passes this share of all maps in ``splits``, and from this share only maps
            with these abstract headings modulo a quarter turn; None = all.
    """

    epochs: Count = 100
    seed: Seed = 0
    batch: BatchSettings = field(default_factory=BatchSettings)
    mirror: bool = False
    optimizer: Annotated[OptimizerSettings | dict[str, Any], or_target(OptimizerSettings)] = field(
        default_factory=OptimizerSettings
    )
    schedule: Annotated[ScheduleSettings | dict[str, Any], or_target(ScheduleSettings)] = field(
        default_factory=ScheduleSettings
    )
    losses: LossSettings = field(default_factory=LossSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    gradient_clip: Positive | None = None
    # Left out of the checkpoint fingerprint (`_fingerprint` of `hdsp.learning.training`), which holds the tasks
    # themselves, and the first of these if they are set (`LATER`).
    accumulate: Count = field(default=1, repr=False)
    limits: LimitSettings = field(default_factory=LimitSettings, repr=False)
    loss: Target | None = field(default=None, repr=False)
    callbacks: dict[str, Target | None] = field(default_factory=dict, repr=False)
    metrics: dict[str, Target] = field(default_factory=dict, repr=False)
    ema: Annotated[float, Field(gt=0, lt=1)] | None = field(default=None, repr=False)
    early_stopping: Count | None = field(default=None, repr=False)
    checkpoint_minutes: Positive = field(default=10.0, repr=False)
    initial: Name | None = field(default=None, repr=False)
    stream: bool = field(default=False, repr=False)
    stream_shards: Count = field(default=8, repr=False)
    share: Annotated[float, Field(gt=0, le=1)] = field(default=1.0, repr=False)
    residues: Annotated[tuple[Residue, ...], Field(min_length=1)] | None = field(default=None, repr=False)
    splits: Annotated[tuple[Name, ...], Field(min_length=1), DISTINCT] = field(default=("train",), repr=False)
    val_splits: Annotated[tuple[Name, ...], Field(min_length=1), DISTINCT] = field(default=("val",), repr=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.stream and (self.share < 1 or self.residues is not None):
            raise fault("stream", True, "false where share is below 1 or residues is set: whole splits are streamed")
        return self


@checked
class HardwareSettings:
    """Device, precision and threads. They change results by rounding only.

    Attributes:
        accelerator: ``auto`` takes a GPU if there is one, in torch. Footprint networks from a folder are evaluated
            without torch, on the CPU, unless this is ``gpu``.
        precision: ``32`` computes in float32. ``auto`` does so, too, but for the largest layer of networks that are
            evaluated without torch (``hdsp.learning.inference``): codes of 8 bits, on any processor. ``bf16`` runs the
            network's trunk in bfloat16, in torch.
        threads: torch CPU threads; None = torch's choice.
        readers: processes that read shards ahead of a streamed training; 0 = the training itself reads them.
    """

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    precision: Literal["auto", "32", "bf16"] = "auto"
    threads: Count | None = None
    readers: Natural = 0

    def device(self) -> "torch.device":
        """Returns the device for computations outside a trainer.

        Raises:
            InputError: a GPU is requested and there is none.
        """
        import torch

        if self.accelerator == "gpu" and not torch.cuda.is_available():
            raise InputError("hardware.accelerator is 'gpu', but torch sees none; allowed are auto, cpu")
        return torch.device("cuda" if self.accelerator != "cpu" and torch.cuda.is_available() else "cpu")

    def apply_threads(self) -> None:
        """Sets this process's torch threads."""
        if self.threads is not None:
            import torch

            torch.set_num_threads(self.threads)


@checked
class LightningSettings:
    """How Lightning runs a training; results depend on it by rounding only.

    Attributes:
        devices, nodes: processes on each machine, and machines; together they share the maps of a batch.
        strategy: a name of Lightning's (``ddp``), or a ``_target_``.
        precision: a name of Lightning's (``16-mixed``); None = as ``HardwareSettings.precision`` says.
        compile: whether torch compiles the network, or arguments for ``torch.compile``.
        profiler: ``simple``, ``advanced``, ``pytorch`` or a ``_target_``; its table goes to a file. None = none.
        log_every: steps between logged losses, learning rate and gradient norm; None = only epochs.
        loggers: a ``_target_`` each.
    """

    devices: Count = 1
    nodes: Count = 1
    strategy: Name | Target = "auto"
    precision: Name | None = None
    compile: bool | dict[str, Any] = False
    profiler: Literal["simple", "advanced", "pytorch"] | Target | None = None
    log_every: Count | None = None
    loggers: dict[str, Target | None] = field(default_factory=dict)


@checked
class TrainingConfig:
    """Configuration for ``train``: model, trainer, and two parts without influence on results."""

    model: ModelSettings = field(default_factory=ModelSettings)
    trainer: TrainerSettings = field(default_factory=TrainerSettings)
    hardware: HardwareSettings = field(default_factory=HardwareSettings)
    lightning: LightningSettings = field(default_factory=LightningSettings)

"""Types of the whole configuration, a class for each group of conf/.

`pipeline.config` composes or reads the values. This module checks all of them before a stage begins, whatever the stage
needs of them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from hdsp.abstract.manual import ManualSettings
from hdsp.abstract.oracle import LabelSettings
from hdsp.base.extensions import HEURISTICS, extension_place
from hdsp.base.settings import DISTINCT, Count, FileName, Name, NotNegative, Positive, Seed, checked, chosen_by, fault
from hdsp.base.workers import MemorySize, Scheduler, SlurmOptions
from hdsp.labels.course_patches import CoursePatchSettings
from hdsp.labels.run.splits import Category, SplitSettings
from hdsp.labels.scan_patches import ScanPatchSettings
from hdsp.learning.learning_settings import HardwareSettings, LightningSettings, ModelSettings, TrainerSettings
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import ArenaDescription
from hdsp.terrain.random_arenas import RandomArena
from hdsp.terrain.scans import Scan
from hdsp.terrain.scenes import TerrainSettings
from hdsp.terrain.sensor_model import SensingSettings
from hdsp.terrain.simulation.courses import CourseSettings
from hdsp.terrain.simulation.lidar import Lidar

from .split_roles import check_roles

#: Prefix of names for shipped abstractions.
SHIPPED = "shipped"
METHODS = ("trained", SHIPPED, f"{SHIPPED}-NAME", "manual", "flat")


def _registered(text: str) -> str:
    """A name in MLflow's registry, NAME or NAME@ALIAS; MLflow refuses others, but only after the training."""
    name, _, alias = text.partition("@")
    named = name.strip() and not set(name) & set("/:")
    aliased = "@" not in text or (
        re.fullmatch(r"[A-Za-z0-9_-]+", alias) and not re.fullmatch(r"latest|v\d+", alias, re.I)
    )
    if not (named and aliased):
        raise fault("", text, "NAME or NAME@ALIAS, NAME without / and :, ALIAS of letters, digits, _ and -, not latest")
    return text


def _method(name: str) -> str:
    if name not in METHODS and not name.startswith(f"{SHIPPED}-"):
        raise fault("", name, f"one of {', '.join(METHODS)}")
    return name


def is_own_heuristic(name: str) -> bool:
    """Whether a name stands for a heuristic of another package."""
    return name not in METHODS and extension_place(HEURISTICS, name) is not None


def is_place(split: str) -> bool:
    """Whether a split's name is the folder or URL of its shards."""
    return "/" in split


def _heuristic(name: str) -> str:
    return name if name == "geometric" or is_own_heuristic(name) else _method(name)


def _named(sources: Any) -> Any:
    """Descriptions of scans with their names, which are the keys in the configuration."""
    if not isinstance(sources, Mapping):
        return sources
    return {
        name: {"name": name, **values} if isinstance(values, Mapping) else values for name, values in sources.items()
    }


def _known(key: str, chosen: Collection[str], names: Collection[str], where: str) -> None:
    for place, name in enumerate(chosen):
        if name not in names:
            raise fault(f"{key}[{place}]", name, f"one of {where}: {', '.join(names) or 'none'}")


Method = Annotated[str, AfterValidator(_method)]
Heuristic = Annotated[str, AfterValidator(_heuristic)]
Weight = Annotated[float, Field(ge=1)]


@checked
class Labelling:
    """Group `labelling`: labelling rules, splits, and where the work is done.

    Attributes:
        settings: labelling rules.
        used: splits that `dvc repro` labels.
        splits: random maps by split.
        mixed, rich, sloped: terrain categories that splits refer to.
        sensing: degradation of maps in splits with `sensing`.
        scheduler, slurm: see `hdsp.base.workers.ClusterSettings`.
        destination: folder or URL for labels of all settings; None = data/labels.
    """

    settings: LabelSettings
    used: Annotated[tuple[Name, ...], DISTINCT]
    splits: dict[str, SplitSettings]
    mixed: tuple[Category, ...]
    rich: tuple[Category, ...]
    sloped: tuple[Category, ...]
    sensing: SensingSettings
    scheduler: Scheduler | None
    slurm: SlurmOptions
    destination: Name | None

    @model_validator(mode="after")
    def _check(self) -> Self:
        _known("used", self.used, self.splits, "labelling.splits")
        return self


@checked
class Scans:
    """Group `scans`: scans of real places by name, and the patches drawn from each map."""

    sources: Annotated[dict[str, Scan], BeforeValidator(_named)]
    patches: ScanPatchSettings


@checked
class EvaluationSet:
    """A set of labelled tasks.

    Attributes:
        tasks: folder of shards among the inputs, or a URL.
        scans: folder of scans, which are labelled first (`hdsp.labels.scan_sets`).
        paper: the paper's set for comparison.
        robot: robot of labels that were not made here; other robots leave the set out.
        split: a labelled split, with the labels of this configuration.
    """

    tasks: Name | None = None
    scans: Name | None = None
    paper: Name | None = None
    robot: Name | None = None
    split: Name | None = None

    @property
    def place(self) -> str:
        """Folder or URL."""
        return self.tasks or self.scans or ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = {name: getattr(self, name) for name in ("tasks", "scans", "split")}
        if sum(value is not None for value in given.values()) != 1:
            raise fault("", given, "either tasks (a folder of shards), scans (a folder of scans) or split")
        return self


@checked
class Evaluation:
    """Group `evaluation`: sets of labelled tasks, and the abstractions to judge.

    Attributes:
        model: source of `trained`: a folder, or the name of a shipped abstraction.
        sets: sets by name.
        watched: sets evaluated after every training epoch.
        methods: abstractions, see `pipeline.abstractions`.
        examples: patches in the figure of labels and predictions.
        edges_threshold: probability from which edges of a published abstraction count an action as feasible.
    """

    model: Name
    sets: Annotated[dict[str, EvaluationSet], Field(min_length=1)]
    watched: Annotated[tuple[Name, ...], DISTINCT]
    methods: Annotated[tuple[Method, ...], Field(min_length=1), DISTINCT]
    examples: Count
    edges_threshold: Annotated[float, Field(gt=0, lt=1)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        _known("watched", self.watched, self.sets, "evaluation.sets")
        return self


@checked
class Simulation:
    """Group `simulation`: the lidar, the arena that it scans, and courses.

    Attributes:
        arena: arena of the planning experiment.
        lidar: the sensor.
        seed: seed for the noise in the arena's scan.
        patches: patches of the set `simulated`.
        used: splits of courses that `dvc repro` makes.
        splits: patches of courses to train on, by split.
        courses: contents of courses.
    """

    arena: ArenaDescription
    lidar: Lidar
    seed: Seed
    patches: CoursePatchSettings
    used: Annotated[tuple[Name, ...], DISTINCT]
    splits: dict[str, CoursePatchSettings]
    courses: CourseSettings

    @model_validator(mode="after")
    def _check(self) -> Self:
        _known("used", self.used, self.splits, "simulation.splits")
        if not self.arena.tasks:
            raise fault("arena.tasks", (), "at least one task")
        return self


@checked
class PlanLimits:
    """Limits of a search in the planning experiment: states, bytes, s."""

    expansions: Count
    memory: Count
    time: Positive


@checked
class RandomTaskSettings:
    """Random tasks on random arenas, beside the tasks of the arena.

    Attributes:
        heuristics: as in `planner.heuristics`; the first one tells hard tasks from easy ones.
        weight: W of weighted A*.
        seed: seed of the first arena; later arenas have later seeds.
        arenas: number of arenas.
        size: their side length, m.
        tasks: number of tasks in each arena.
        expansions: limit of a search.
        hard: a task is hard if the first heuristic needs as many expansions.
    """

    heuristics: Annotated[tuple[Heuristic, ...], Field(min_length=1), DISTINCT]
    weight: Weight
    seed: Seed
    arenas: Count
    size: Positive
    tasks: Count
    expansions: Count
    hard: Count


@checked
class PlannerSettings:
    """Group `planner`: the planning experiment.

    Attributes:
        heuristics: `geometric`, the name of an abstraction, or of another package's heuristic.
        weights: of weighted A*.
        margin: distance between the body and obstacles, m.
        limits: a search ends at its first limit.
        repeats: largest number of repetitions of a search; the median time is reported.
        repeat_below: s; no repetitions beyond this total time.
        random: random tasks beside those of the arena.
    """

    heuristics: Annotated[tuple[Heuristic, ...], Field(min_length=1), DISTINCT]
    weights: Annotated[tuple[Weight, ...], Field(min_length=1), DISTINCT]
    margin: NotNegative
    limits: PlanLimits
    repeats: Count
    repeat_below: NotNegative
    random: RandomTaskSettings


@checked
class Runtime:
    """Group `runtime`: workers, folders, hardware. Results depend on it by rounding only.

    Attributes:
        workers, memory, dashboard: see `hdsp.base.workers.ClusterSettings`.
        progress: whether stages report their progress.
        inputs: folder with data/, models/ and reports/ of earlier stages.
        outputs: folder for the results of this stage; None = see `pipeline.stage.run_stage`.
        data_dir: folder with published data sets and scans; None = HDSP_DATA_DIR, or fetched.
        variant: name of a shipped abstraction beside the robot's default one.
        hardware: device, precision and threads.
        lightning: how Lightning runs a training.
        system_metrics: whether MLflow records load and memory of the machine.
        register: name under which MLflow registers the model, `NAME@ALIAS` with an alias; None = it is not registered.
    """

    workers: Count | None
    memory: MemorySize | None
    dashboard: Name | None
    progress: bool
    inputs: Name
    outputs: Name | None
    data_dir: Name | None
    variant: FileName | None
    hardware: HardwareSettings
    lightning: LightningSettings
    system_metrics: bool
    register: Annotated[str, AfterValidator(_registered)] | None


@checked
class SearchSettings:
    """Group `search`: a search for settings (`pipeline.search`).

    Attributes:
        name: name of the study.
        space: values in Hydra's syntax, by key.
        trials: trials with a value, those of earlier calls included.
        jobs: trials at the same time.
        metric: number in `reports/training.json`.
        direction: whether small or large values are better.
        seed: seed of the sampler.
        storage: Optuna's storage; None = SQLite in outputs/search.
    """

    name: FileName
    space: dict[str, Any]
    trials: Count
    jobs: Count
    metric: Name
    direction: Literal["minimize", "maximize"]
    seed: Seed
    storage: Name | None


@checked
class Config:
    """The whole configuration: groups of conf/ by name, and the name of the profile."""

    robot: Robot
    terrain: TerrainSettings
    labelling: Labelling
    scans: Scans
    model: ModelSettings
    trainer: TrainerSettings
    evaluation: Evaluation
    abstraction: ManualSettings
    arena: Annotated[
        ArenaDescription | RandomArena, chosen_by("source", {"scanned": ArenaDescription, "random": RandomArena})
    ]
    simulation: Simulation
    planner: PlannerSettings
    search: SearchSettings
    runtime: Runtime
    profile: Name

    @model_validator(mode="after")
    def _check(self) -> Self:
        splits = {**self.labelling.splits, **self.simulation.splits}
        for role in ("splits", "val_splits"):
            own = tuple(name for name in getattr(self.trainer, role) if not is_place(name))
            _known(f"trainer.{role}", own, splits, "labelling.splits, simulation.splits, or a folder (with a /)")
        for name, entry in self.evaluation.sets.items():
            if entry.split is not None and entry.split not in splits:
                raise fault(f"evaluation.sets.{name}.split", entry.split, f"one of {', '.join(splits)}")
        if not self.arena.tasks:
            raise fault("arena.tasks", (), "at least one task")
        check_roles(self)
        return self

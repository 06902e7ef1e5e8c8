"""Many fits: which images, with which seeds and options, from a folder or a TOML file."""

from __future__ import annotations

import glob
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field, field_validator

from ..common.choices import AUTO, IMAGE_FILES, ZARR, is_auto, is_image
from ..common.reading import read_text, toml_values
from ..common.toml import toml_document
from ..common.writing import write_atomically
from ..errors import PROGRAM, InputError
from ..images.stacks import read_voxel_size
from .command import options_of
from .fit_settings import validated

if TYPE_CHECKING:
    from .settings import RunSettings

SEED_ENDS = ("{stem}_labels.tif", "{stem}_seeds.ply", "{stem}.csv")
STEM = "{stem}"  # in a pattern of seeds: the image's name without its extension


class BatchRun(BaseModel):
    """One fit of a batch file: an image, and what differs for it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    image: str = Field(description="file; relative to the folder of the batch file")
    seeds: str | None = Field(default=None, description="file; by default that of the pattern")
    name: str | None = Field(default=None, description="of its folder; by default the image's")
    options: tuple[str, ...] = Field(default=(), description="of fit, after those of all")

    @field_validator("name")
    @classmethod
    def _of_one_folder(cls, name: str | None) -> str | None:
        if name is not None and (name in ("", "..") or Path(name).name != name):
            raise ValueError(f"must be the name of one folder, not {name!r}")
        return name


class BatchSettings(BaseModel):
    """A batch file (TOML)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    images: tuple[str, ...] = Field(default=(), description="files or patterns such as *.tif")
    seeds: str | None = Field(default=None, description="pattern: {stem} stands for the image's")
    options: tuple[str, ...] = Field(default=(), description="of fit, for all")
    runs: tuple[BatchRun, ...] = Field(default=(), description="images with values of their own")

    def to_toml(self) -> str:
        """The batch file."""
        return toml_document(self.model_dump(exclude=None if self.runs else {"runs"}))


@dataclass(frozen=True)
class BatchJob:
    """A fit to run: name of its folder, files, and further options of ``fit``."""

    name: str
    image: Path
    seeds: str | None
    options: tuple[str, ...]

    def words(self, folder: Path) -> list[str]:
        """The arguments after ``napari-deltamic`` that fit this image into a folder."""
        seeds = [] if self.seeds is None else ["--seeds", self.seeds]
        return ["fit", str(self.image), *seeds, *self.options, "--overwrite", "-o", str(folder)]


def batch_jobs(
    source: str | Path, seeds: str | None = None, options: Sequence[str] = ()
) -> list[BatchJob]:
    """The fits of a folder of stacks, or of a batch file.

    Parameters
    ----------
    source
        A folder: every stack in it, except those that the pattern names as seeds of another. Or a
        TOML file with the fields of :class:`BatchSettings`.
    seeds
        Pattern of the seed files, ``{stem}`` for the image's name without its extension; overrides
        the pattern in the file.
    options
        Options of ``fit`` for all images, which follow those in the file.

    Returns
    -------
    Jobs with distinct names. Whether the files exist is only found out when their turn comes.

    Raises
    ------
    InputError
        If there is no such folder or file, it has an unknown key or a wrong value, there is no
        image, or two images have the same name.
    """
    source = Path(source)
    found = _of_folder(source, seeds) if source.is_dir() else _of_file(source, seeds)
    jobs = [BatchJob(j.name, j.image, j.seeds, (*j.options, *options)) for j in found]
    if not jobs:
        raise InputError(f"{source}: there is no image ({', '.join(IMAGE_FILES)})")
    seen: set[str] = set()
    for job in jobs:
        if job.name in seen:
            raise InputError(f"two images are named {job.name}: give one of them another name")
        seen.add(job.name)
    return jobs


def batch_for(folder: str | Path, settings: RunSettings) -> BatchSettings:
    """A batch of all stacks in a folder, with the settings of one run.

    Seeds are the files that the first of ``SEED_ENDS`` to fit any stack names; if none fits, cells
    are found in the images. The voxel size of the run is used only for files that have none.

    Raises
    ------
    InputError
        If there is no image, the PSF cannot be given on a command line, or the run has a second
        view, which belongs to one image.
    """
    folder = Path(folder)
    if settings.scene.effects.view is not None:
        raise InputError("a second view belongs to one image: take it out to run on a folder")
    names = {p.name for p in folder.iterdir()}
    seeds = next((end for end in SEED_ENDS if _fits(end, names)), AUTO)
    stacks = [job.image for job in batch_jobs(folder, seeds)]
    words = options_of(settings)
    at = words.index("--voxel-size")
    size = tuple(words[at : at + 4])
    del words[at : at + 4]
    told = {stack.name: _tells_voxel_size(stack, settings.channel) for stack in stacks}
    return BatchSettings(
        images=tuple(name for name, tells in told.items() if tells),
        seeds=seeds,
        options=tuple(words),
        runs=tuple(BatchRun(image=name, options=size) for name, tells in told.items() if not tells),
    )


def write_batch(folder: str | Path, settings: RunSettings) -> str:
    """Write ``batch.toml`` into a folder of stacks; returns the command that fits them all.

    Raises
    ------
    InputError
        If there is a file of that name already, no image, or the settings suit one image only.
    """
    path = Path(folder) / "batch.toml"
    if path.exists():
        raise InputError(f"{path} is there already: rename it, or run it")
    write_atomically(path, batch_for(folder, settings).to_toml().encode())
    return shlex.join([PROGRAM, "batch", str(path), "-o", str(Path(folder) / "results")])


def _fits(end: str, names: set[str]) -> bool:
    """Whether a pattern of seeds names an existing file for at least one stack."""
    stacks = (Path(name) for name in names if is_image(name))
    return any(end.replace(STEM, _stem(stack)) in names for stack in stacks)


def _tells_voxel_size(stack: Path, channel: str | None) -> bool:
    try:
        return read_voxel_size(stack, channel) is not None
    except InputError:
        return True  # the batch will say what is wrong with it


def _of_folder(folder: Path, seeds: str | None) -> list[BatchJob]:
    known = (p for p in folder.iterdir() if is_image(p))
    stacks = sorted(p for p in known if p.is_dir() == (p.suffix.lower() == ZARR))
    used = {_seeds(seeds, stack, folder) for stack in stacks}
    return [_job(stack, seeds, folder) for stack in stacks if str(stack.absolute()) not in used]


def _of_file(path: Path, seeds: str | None) -> list[BatchJob]:
    try:
        settings: BatchSettings = validated(BatchSettings, toml_values(read_text(path)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    folder, pattern = path.parent, seeds or settings.seeds
    jobs = []
    for text in settings.images:
        is_pattern = glob.has_magic(text) and not (folder / text).exists()
        names = [text]
        if is_pattern:
            fitting = sorted(glob.glob(text, root_dir=folder))
            used = {_seeds(pattern, folder / name, folder) for name in fitting}
            names = [name for name in fitting if str((folder / name).absolute()) not in used]
        if not names:
            raise InputError(f"{path}: no file fits {text!r} in {folder.absolute()}")
        jobs += [_job(folder / name, pattern, folder) for name in names]
    for run in settings.runs:
        job = _job(folder / run.image, run.seeds or pattern, folder)
        jobs.append(BatchJob(run.name or job.name, job.image, job.seeds, run.options))
    return [BatchJob(j.name, j.image, j.seeds, (*settings.options, *j.options)) for j in jobs]


def _job(image: Path, seeds: str | None, folder: Path) -> BatchJob:
    return BatchJob(_stem(image), image.absolute(), _seeds(seeds, image, folder), ())


def _seeds(pattern: str | None, image: Path, folder: Path) -> str | None:
    """The seeds of an image by the pattern: ``auto``, or a file in the folder; None for none."""
    if pattern is None or is_auto(pattern):
        return pattern
    named = pattern.replace(STEM, _stem(image))
    return str((folder / named).absolute()) if Path(named).suffix else named


def _stem(image: Path) -> str:
    inner = Path(image.stem)
    return inner.stem if inner.suffix.lower() == ".ome" else image.stem

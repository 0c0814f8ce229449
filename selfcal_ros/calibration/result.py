# Copyright 2026 selfcal_ros contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
What a calibration returns: a `Calibration`, or a `NotCalibrated` that says why.

Both carry what was found out as data (`Finding`). Sentences are derived from it; the tables of
words lie below, in `selfcal_ros.findings`, so that both print themselves without a report.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NoReturn

import numpy as np

from selfcal_ros.calibration.card import (calibration_card, calibration_text, grade_of,
                                          refusal_card)
from selfcal_ros.calibration.mount import Mount
from selfcal_ros.calibration.reconstruction import Measured, Reconstruction, StructureSample
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding, sentences
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.population import Population
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.measured_digits import with_sigma
from selfcal_ros.values.motion import Motion
from selfcal_ros.values.parameter_status import Status
from selfcal_ros.values.track_labels import TrackLabels

#: Kinds of refusals that know something of the camera, too little for a calibration.
HINT, CENTRE_OUTSIDE = 'only_a_hint', 'centre_outside'
#: Motions that `Calibration.motion` and `NotCalibrated.motion` may name.
MOTIONS = ('none', 'rotation', 'pivot', 'translation', 'planar', 'circular', 'general',
           'known-object', 'unknown')


@dataclass(frozen=True)
class FixedPoints:
    """
    Fixed image points of planar motion, in undistorted pixels (thesis 5.1).

    Attributes
    ----------
    horizon : ndarray, shape (3,)
        Vanishing line l of the planes of motion.
    vanishing_point : ndarray, shape (3,)
        Vanishing point v of the rotation axis.
    circular_point : ndarray of complex, shape (3,)
        Image i of a circular point; the other, j, is its conjugate.

    """

    horizon: np.ndarray
    vanishing_point: np.ndarray
    circular_point: np.ndarray


@dataclass(frozen=True)
class Identifiability:
    """
    Where the knowledge of each parameter comes from.

    Attributes
    ----------
    from_images : dict of str to float
        Share of the variance of every estimated parameter that the image noise causes; the rest
        is the uncertainty of stated facts.
    without : dict of str to dict of str to float
        By stated fact: how many times as large the sigma of each estimated parameter would be
        without it; infinite where the images alone leave the parameter unobservable.
    weakest : dict of str to float
        The direction of the parameters that is determined worst: one sigma along it, in the
        units of the parameters.
    weakest_share : float
        Its length as a share of what makes a parameter unobservable.

    """

    from_images: dict[str, float]
    without: dict[str, dict[str, float]]
    weakest: dict[str, float]
    weakest_share: float

    def findings(self) -> tuple[Finding, ...]:
        """Tell what rests on which fact."""
        found = []
        for fact, factors in self.without.items():
            lost = tuple(name for name, factor in factors.items() if not np.isfinite(factor))
            if lost:
                found.append(Finding('fact_decides', fact=fact, lost=lost))
                continue
            name = max(factors, key=lambda one: factors[one])
            if factors[name] > 2:
                found.append(Finding('fact_narrows', fact=fact, name=name, factor=factors[name]))
        return tuple(found)

    def sentences(self) -> tuple[str, ...]:
        """Say what rests on which fact."""
        return sentences(self.findings())


@dataclass(frozen=True)
class FocalCourse:
    """
    A focal length that varies from frame to frame.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
        Ascending.
    fx : ndarray, shape (V,)
        Pixels. The fx of the camera is their geometric mean.
    sigma : ndarray, shape (V,)
        Standard deviation of each, pixels.
    is_steady : bool
        Whether it grows steadily, as far as the images tell.

    """

    frames: np.ndarray
    fx: np.ndarray
    sigma: np.ndarray
    is_steady: bool = False

    def at(self, frame: float) -> Measured:
        """Return the focal length at a frame: between two on the line, outside the nearest."""
        return Measured(float(np.exp(np.interp(frame, self.frames, np.log(self.fx)))),
                        float(np.interp(frame, self.frames, self.sigma)))


@dataclass(frozen=True)
class Calibration:
    """
    A calibrated camera with the uncertainty of every parameter; true in a condition.

    Attributes
    ----------
    camera : Camera
    covariance : ndarray, shape (k, k)
        Of `parameter_names`; zero rows for held parameters.
    status : dict
        Per parameter 'estimated', 'held' or 'unobservable'.
    held_by : dict
        Per held parameter, the fact that holds it.
    motion : str
        One of `MOTIONS`.
    facts : CameraFacts
    frames : tuple of int
        Frames that were used.
    reprojection_rms_px : float
    noise_sigma_px : float
        Estimated standard deviation of one image coordinate.
    observation_count, outlier_count : int
    reconstruction : Reconstruction or None
        None where calibrations were combined or read from a file.
    fixed_points : FixedPoints, optional
    findings : tuple of Finding
        What a user should know.
    software : str
    residuals : ndarray, shape (N, 2), optional
        Of the observations used, pixels.
    identifiability : Identifiability, optional
        What the images say and what the facts say.
    measured : StructureSample, optional
        What the uncertainty means for measurements in the structure.
    population : Population, optional
        What real lenses are like, where that counted as a measurement.
    focal : FocalCourse, optional
        Where the focal length varies: that of every frame. The camera's is the geometric mean.
    shutter : RowReadout, optional
        The rolling shutter, where rows are read one after the other.
    labels : TrackLabels, optional
        What every track is, where things moved by themselves or matches jumped.
    mount : Mount or NoEstimate, optional
        Where the camera sits on the robot, or why that is not known, where its poses were given.

    Examples
    --------
    >>> import numpy as np
    >>> from selfcal_ros import calibrate, CameraFacts
    >>> from selfcal_ros.synthetic.scenes import sequence_si
    >>> scene = sequence_si(np.random.default_rng(0), noise_px=0.1)
    >>> result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, distortion='none'))
    >>> result.motion, result.status['fx'], result.status['k1']
    ('planar', 'estimated', 'held')
    >>> error = result.camera.K[0, 0] - scene.camera.K[0, 0]
    >>> bool(abs(error) < 3 * result.sigma['fx'])
    True

    """

    camera: Camera
    covariance: np.ndarray
    status: dict[str, Status]
    held_by: dict[str, str]
    motion: Motion
    facts: CameraFacts
    frames: tuple[int, ...]
    reprojection_rms_px: float
    noise_sigma_px: float
    observation_count: int
    outlier_count: int
    reconstruction: Reconstruction | None
    fixed_points: FixedPoints | None = None
    findings: tuple[Finding, ...] = ()
    software: str = ''
    residuals: np.ndarray | None = field(default=None, repr=False)
    identifiability: Identifiability | None = field(default=None, repr=False)
    measured: StructureSample | None = field(default=None, repr=False)
    population: Population | None = field(default=None, repr=False)
    focal: FocalCourse | None = field(default=None, repr=False)
    shutter: RowReadout | None = None
    labels: TrackLabels | None = field(default=None, repr=False)
    mount: Mount | NoEstimate | None = field(default=None, repr=False)

    def __bool__(self) -> Literal[True]:
        """Be true: there is a calibration."""
        return True

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, one sentence each."""
        return sentences(self.findings)

    def magnification(self, frames: np.ndarray) -> np.ndarray:
        """Return the focal lengths at frames (N,) over that of `camera`."""
        if self.focal is None:
            return np.ones(len(frames))
        log_fx = np.interp(frames, self.focal.frames, np.log(self.focal.fx))
        ratio: np.ndarray = np.exp(log_fx) / self.camera.K[0, 0]
        return ratio

    def steadied(self, view: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return pixels as `camera` would see them: of its focal length, and not shifted.

        Parameters
        ----------
        view : ndarray of int, shape (N,)
            Places among the views of the reconstruction.
        xy : ndarray, shape (N, 2)

        Returns
        -------
        xy : ndarray, shape (N, 2)
        scale : ndarray, shape (N, 1)
            By which a length in the image is larger than there.

        """
        shape, centre = self.reconstructed, self.camera.K[:2, 2]
        scale = self.magnification(np.asarray(shape.frames)[view])[:, None]
        if shape.shift_px is not None:
            xy = xy - shape.shift_px[view]
        return centre + (xy - centre) / scale, scale

    def focal_of(self, frame: float) -> Measured:
        """Return fx at a frame, which need not be among `frames`, with its sigma."""
        if self.focal is None:
            return Measured(float(self.camera.K[0, 0]), self.sigma['fx'])
        return self.focal.at(frame)

    def camera_of(self, frame: float) -> Camera:
        """Return the camera at a frame: `camera`, unless its focal length varies."""
        if self.focal is None:
            return self.camera
        return self.camera.magnified(float(self.magnification(np.array([frame]))[0]))

    @property
    def reconstructed(self) -> Reconstruction:
        """The reconstruction; ArgumentError where it was left behind, as in a file."""
        if self.reconstruction is None:
            raise ArgumentError('This calibration comes without its reconstruction, as one that '
                                'was read from a file; calibrate anew where that is needed.')
        return self.reconstruction

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `covariance`."""
        return self.camera.parameter_names

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each of `parameter_names`, zero where held."""
        return dict(zip(self.parameter_names, np.sqrt(np.diag(self.covariance)).tolist()))

    @property
    def focal_sigma_share(self) -> float:
        """Standard deviation of fx as a share of fx."""
        return float(self.sigma['fx'] / self.camera.K[0, 0])

    @property
    def grade(self) -> str:
        """'good', 'partial' (something is not determined) or 'coarse' (fx, to more than 1 %)."""
        return grade_of(self.camera.K, self.covariance, self.status)

    def __str__(self) -> str:
        """Say what was found in a few lines, each value with its sigma."""
        return calibration_text(self.grade, self.camera, self.sigma, self.status, self._rests_on,
                                self.notes)

    def __repr__(self) -> str:
        """Name the result in a line; its arrays are long."""
        fx, spread = with_sigma(float(self.camera.K[0, 0]), self.sigma['fx'])
        return f'<Calibration: {", ".join(self._rests_on)}, fx {fx} ± {spread or 0}>'

    def _repr_html_(self) -> str:
        """Show a card in a notebook."""
        return calibration_card(self.grade, self.camera, self.sigma, self.status, self._rests_on,
                                self.notes)

    @property
    def _rests_on(self) -> tuple[str, ...]:
        """What the result is of, in a few words each."""
        return (f'{self.motion} motion' if self.motion != 'known-object' else 'known object',
                f'{len(self.frames)} view{"s" if len(self.frames) != 1 else ""}',
                f'{self.camera.width} × {self.camera.height} px',
                f'rms {self.reprojection_rms_px:.2g} px')


@dataclass(frozen=True)
class NotCalibrated:
    """
    Why there is no calibration; false in a condition.

    Attributes
    ----------
    reason : str
        In a sentence or two.
    advice : str
        What motion, fact or data would help; may be empty.
    motion : str
        One of `MOTIONS`, as far as it could be told.
    frames : tuple of int
    facts : CameraFacts
    status : dict
        Per parameter 'held' or 'unobservable', as far as it is known.
    software : str
    kind : str
        Why, for programs: one of `selfcal_ros.findings.finding.KINDS`; empty where it was not
        recorded (a file of an older version).
    values : mapping
        The numbers and names that decided, as in `Finding`.
    findings : tuple of Finding
        What else was found, for example the motion that would help most.
    hint : Calibration, optional
        Where `is_hint`, what the images suggest: not to be used as a calibration.

    Examples
    --------
    >>> import numpy as np
    >>> from selfcal_ros import calibrate, CameraFacts
    >>> from selfcal_ros.synthetic.special_scenes import pure_translation
    >>> scene = pure_translation(np.random.default_rng(0))
    >>> result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    >>> bool(result), result.motion
    (False, 'translation')
    >>> str(result).startswith('Not calibrated: ')
    True

    """

    reason: str
    advice: str = ''
    motion: Motion = 'unknown'
    frames: tuple[int, ...] = ()
    facts: CameraFacts = CameraFacts()
    status: dict[str, Status] = field(default_factory=dict)
    software: str = ''
    kind: str = ''
    values: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    hint: Calibration | None = field(default=None, repr=False, compare=False)

    @staticmethod
    def of(refusal: NoEstimate, *, frames: Iterable[int] = (), facts: CameraFacts = CameraFacts(),
           motion: Motion = 'unknown', software: str = '') -> NotCalibrated:
        """
        Put the failure of a method before the user.

        Parameters
        ----------
        refusal : NoEstimate
            Its values `motion`, `status` and `facts` stand for what is given here, where it has
            them; those in `further` are findings of their own, and `hint` is an estimate.
        frames : iterable of int
        facts : CameraFacts
        motion, software : str

        Returns
        -------
        NotCalibrated

        """
        values = dict(refusal.values)
        motion, facts = values.pop('motion', motion), values.pop('facts', facts)
        status, further = values.pop('status', {}), tuple(values.pop('further', ()))
        hint = values.pop('hint', None)
        advice = ' '.join(filter(None, [refusal.advice, *(one.sentence for one in further)]))
        return NotCalibrated(refusal.reason, advice, motion, tuple(int(f) for f in frames), facts,
                             dict(status), software, refusal.kind, values, further, hint)

    @property
    def is_hint(self) -> bool:
        """Whether `values` has a focal length, which is a hint and no calibration."""
        return self.kind in (HINT, CENTRE_OUTSIDE)

    @property
    def grade(self) -> str:
        """'hint' or 'bad', as `Calibration.grade` says how good a calibration is."""
        return 'hint' if self.is_hint else 'bad'

    def _repr_html_(self) -> str:
        """Show a card in a notebook."""
        facts = (f'{self.motion} motion',) if self.motion != 'unknown' else ()
        return refusal_card(self.grade, self.reason, self.advice, facts)

    def __bool__(self) -> Literal[False]:
        """Be false: there is no calibration."""
        return False

    def __str__(self) -> str:
        """Say why, and what would help."""
        start = 'A hint, no calibration' if self.is_hint else 'Not calibrated'
        return f'{start}: {self.reason}' + (f' {self.advice}' if self.advice else '')

    def __getattr__(self, name: str) -> NoReturn:
        """Refuse to be used as a calibration."""
        if name.startswith('_'):
            raise AttributeError(name)
        raise AttributeError(f'There is no {name!r}: {self}')

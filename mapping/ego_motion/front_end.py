"""From samples to the filter's rows: tilt, standstill, trust in the wheels, tick by tick."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mapping.ego_motion.blocks import Blocks, force_blocks
from mapping.ego_motion.filter_types import Int64Array
from mapping.ego_motion.grip import slip_variance
from mapping.ego_motion.ground import GroundWatch
from mapping.ego_motion.levelling import Levelled, level, sway
from mapping.ego_motion.rows import RowBatch, gyro_rows, merged, speed_rows, wheel_rows
from mapping.ego_motion.sample_queue import SampleQueue
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.standstill import (
    BoolArray,
    MotionDetector,
    Motionless,
    nothing_known,
    since_they_began,
    vibration_level,
    without_ends,
)
from mapping.ego_motion.states import (
    COLUMNS,
    TICK,
    TICK_FORCE,
    TICK_PITCH,
    TICK_PITCH_RATE,
    TICK_PITCH_VARIANCE,
    TICK_REST_VARIANCE,
    TICK_ROLL,
    TICK_ROLL_RATE,
    TICK_ROLL_VARIANCE,
    TICK_SLIP_VARIANCE,
    TICK_SPEED_WALK,
    TICK_STILL,
)
from mapping.ego_motion.watch import HealthWatch
from mapping.geometry import Float64Array

_LEVEL_HALF_S = 0.2
_SWAY_HALF_S = 0.3
# So many ticks at a time: bounds the memory after a gap of hours.
_MOST_TICKS = 500


class FrontEnd:
    """Keeps the samples of the last second and makes rows of them.

    Args:
        settings: of ego-motion.

    Attributes:
        force, gyro, wheels, vibration: queues of samples in base_link's axes: specific force (3);
            rate; speed, its sigma, yaw rate, its sigma; RMS acceleration and speed by frequency.
        watch: what it noticed.
    """

    def __init__(self, settings: EgoMotionSettings) -> None:
        self._settings = settings
        self._tick_ns = round(settings.tick_s * 1e9)
        self._half = round(settings.levelling_half_window_s / settings.tick_s)
        self._level_half = round(_LEVEL_HALF_S / settings.tick_s)
        self._margin = math.ceil(settings.still_margin_s / settings.tick_s)
        self._margin_alone = math.ceil(settings.still_margin_alone_s / settings.tick_s)
        ahead = max(self._margin, self._margin_alone)
        self._sway_half = round(_SWAY_HALF_S / settings.tick_s)
        self._reach = max(self._half + self._sway_half, self._level_half + ahead)
        self.force, self.gyro = SampleQueue(3), SampleQueue(1)
        self.wheels, self.vibration = SampleQueue(4), SampleQueue(2)
        self.watch = HealthWatch(settings)
        self._detector = MotionDetector(settings)
        self._ground = GroundWatch(settings)
        self._blocks: Blocks | None = None
        self._found = nothing_known(2 * ahead)
        self._last_tilt = np.zeros(2)
        self._next_block = self._next_tick = 0

    @property
    def reach_ns(self) -> int:
        """How much later a sample may matter to a tick."""
        return (self._reach + 1) * self._tick_ns

    @property
    def first_tick_ns(self) -> int:
        """Time of the first tick."""
        return self._next_tick * self._tick_ns

    def begin(self, t_ns: int) -> None:
        """Set the first tick at or after a time."""
        self._next_block = self._next_tick = -(-t_ns // self._tick_ns)

    def rows(self, until_ns: int, *, last: bool = False) -> list[RowBatch]:
        """Return the rows that samples up to a time allow, batch by batch.

        Args:
            until_ns: all samples up to it are there.
            last: there will be no more, so that ticks need not wait for theirs.
        """
        for queue in (self.force, self.gyro, self.wheels, self.vibration):
            queue.release(until_ns)
        end = (until_ns + self._tick_ns // 2) // self._tick_ns
        batches = []
        while self._next_block < end:
            size = min(_MOST_TICKS, end - self._next_block)
            self.watch.look(self._add_blocks(self._next_block + np.arange(size)))
            batches += self._ready_rows()
        if last:
            self._add_blocks(self._next_block + np.arange(self._reach))
            batches += self._ready_rows()
        return batches

    def _add_blocks(self, index: Int64Array) -> Blocks:
        """Measure the blocks around the next ticks."""
        s, t_ns = self._settings, index * self._tick_ns
        mean, count, scatter, shock = force_blocks(
            self.force.t_ns, self.force.values, t_ns, self._tick_ns, s.shock_m_s2
        )
        wheels, wheels_far = self.wheels.at(t_ns)
        gyro, gyro_far = self.gyro.at(t_ns)
        vibration, vibration_far = self.vibration.at(t_ns)
        silent = vibration_far > 0.5e9
        new = Blocks(
            t_ns=t_ns,
            force_m_s2=mean,
            count=count,
            scatter_m2_s4=scatter,
            shock=shock,
            speed_m_s=wheels[:, 0],
            wheels_ok=wheels_far <= s.wheels_gap_s * 1e9,
            wheel_turn_rad_s=wheels[:, 2],
            wheel_turn_sigma_rad_s=wheels[:, 3],
            turn_rad_s=gyro[:, 0],
            gyro_ok=gyro_far <= s.gyro_gap_s * 1e9,
            vibration_m_s2=np.where(silent, np.nan, vibration[:, 0]),
        )
        keep = 2 * self._reach
        self._blocks = new if self._blocks is None else self._blocks.last(keep).joined(new)
        self._next_block += len(index)
        return new

    def _ready_rows(self) -> list[RowBatch]:
        """Return the rows of the ticks that have all their blocks."""
        size = self._next_block - self._reach - self._next_tick
        if size <= 0 or self._blocks is None:
            return []
        blocks = self._padded(self._blocks.last(size + 2 * self._reach), size)
        ticks_ns = (self._next_tick + np.arange(size)) * self._tick_ns
        motionless, still = self._motion(blocks, size)
        values = self._tick_values(blocks, self._level(blocks), motionless, still)
        self.watch.judge(ticks_ns, motionless)
        start_ns, end_ns = int(ticks_ns[0]) - self._tick_ns, int(ticks_ns[-1])
        wheels_ok = blocks.wheels_ok[self._reach : self._reach + size]
        parts = [
            (ticks_ns, TICK, values),
            gyro_rows(self._settings, self.gyro, start_ns, end_ns),
            wheel_rows(self._settings, self.wheels, start_ns, ticks_ns, motionless.stuck),
            speed_rows(self._settings, self.vibration, ticks_ns, motionless, wheels_ok),
        ]
        self._next_tick += size
        for queue in (self.force, self.gyro, self.wheels, self.vibration):
            queue.forget(end_ns)
        return [merged(parts)]

    def _padded(self, blocks: Blocks, size: int) -> Blocks:
        """Return blocks with empty ones in front where the recording begins."""
        missing = size + 2 * self._reach - len(blocks)
        if not missing:
            return blocks
        t_ns = blocks.t_ns[0] - self._tick_ns * np.arange(missing, 0, -1)
        nothing, no = np.zeros(missing), np.zeros(missing, np.bool_)
        zero = np.zeros(missing, np.int64)
        empty = Blocks(
            t_ns,
            np.zeros((missing, 3)),
            zero,
            nothing,
            no,
            nothing,
            no,
            nothing,
            nothing,
            nothing,
            no,
            nothing + np.nan,
        )
        return empty.joined(blocks)

    def _level(self, blocks: Blocks) -> Levelled:
        """Return the tilt of the ticks, and of some more on either side."""
        s = self._settings
        speed = np.where(blocks.wheels_ok, blocks.speed_m_s, 0.0)
        turn = np.where(blocks.gyro_ok, blocks.turn_rad_s, 0.0)
        own = np.column_stack([np.gradient(speed, s.tick_s), speed * turn, np.zeros(len(speed))])
        both = blocks.wheels_ok[1:] == blocks.wheels_ok[:-1]
        own[1:-1, 0] *= both[1:] & both[:-1]  # no jump where wheels come or go
        cut = self._reach - self._half - self._sway_half
        chosen = slice(cut, len(blocks) - cut)
        weight = (blocks.count > 0) & ~blocks.shock
        return level(
            (blocks.force_m_s2 - own)[chosen],
            weight[chosen].astype(np.float64),
            self._half,
            s.tick_s,
            s.levelling_sigma_ratio,
            s.levelling_floor_rad,
        )

    def _motion(self, blocks: Blocks, size: int) -> tuple[Motionless, BoolArray]:
        """Return what the detector says, and standstill without its ends.

        The detector runs ahead of the ticks by the longer margin, which the ends need.
        """
        widest = max(self._margin, self._margin_alone)
        rms = vibration_level(blocks, self._level_half)
        ahead = slice(self._reach + widest, self._reach + widest + size)
        fresh = self._detector.add(rms[ahead], blocks.speed_m_s[ahead], blocks.wheels_ok[ahead])
        found = self._found.part(slice(-2 * widest, None)).joined(fresh)
        self._found = found
        around = slice(self._reach - widest, ahead.stop)
        wheels_ok = blocks.wheels_ok[around]
        confirmed = wheels_ok & found.standing & (found.quiet | ~np.isfinite(rms[around]))
        still = np.where(
            wheels_ok[widest:-widest],
            without_ends(confirmed, self._margin, widest),
            without_ends(found.quiet, self._margin_alone, widest),
        )
        now = found.part(slice(widest, -widest))
        return replace(
            now, stuck=since_they_began(found.stuck, widest, self._settings.tick_s)
        ), still

    def _tick_values(
        self, blocks: Blocks, wider: Levelled, motionless: Motionless, still: BoolArray
    ) -> Float64Array:
        """Return the (N, COLUMNS) columns of `states.TICK`."""
        s = self._settings
        here = slice(self._reach, -self._reach)
        levelled = wider.inner(self._sway_half)
        wheels_ok, heard = blocks.wheels_ok[here] & ~motionless.stuck, blocks.count[here] > 0
        force = blocks.force_m_s2[here, 0]
        noise = blocks.scatter_m2_s4[here] / 3.0 / np.maximum(blocks.count[here], 1)
        guess = self._ground.add(
            levelled.roll_rad,
            levelled.roll_sigma_rad,
            levelled.pitch_rad,
            force,
            noise,
            still & heard,
        )
        guided = ~wheels_ok & ~still & heard & (guess.share > 0.0)
        share = np.where(guided, guess.share, 0.0)
        at_rest = -np.arcsin(np.clip(guess.rest_m_s2 / s.gravity_m_s2, -1.0, 1.0))
        slip, doubt = (part[here] for part in slip_variance(blocks, s))
        # Without wheels a change of the force is as likely the rover's own acceleration.
        unseen = np.where(still, 0.0, np.where(wheels_ok, doubt, 1.0))
        own = unseen * s.unseen_acceleration_ratio**2 * sway(wider.pitch_rad, self._sway_half)
        values = np.zeros((len(still), COLUMNS))
        values[:, TICK_ROLL] = levelled.roll_rad
        values[:, TICK_PITCH] = (1.0 - share) * levelled.pitch_rad + share * at_rest
        values[:, TICK_ROLL_RATE] = levelled.roll_rate_rad_s
        values[:, TICK_PITCH_RATE] = (1.0 - share) * levelled.pitch_rate_rad_s
        values[:, TICK_ROLL_VARIANCE] = levelled.roll_sigma_rad**2
        values[:, TICK_PITCH_VARIANCE] = (1.0 - share) ** 2 * (levelled.pitch_sigma_rad**2 + own)
        values[:, TICK_PITCH_VARIANCE] += guided * guess.pitch_variance_rad2
        values[:, TICK_STILL] = np.where(still, np.where(wheels_ok, 2.0, 1.0), 0.0)
        values[:, TICK_FORCE] = share * (force - guess.rest_m_s2)
        values[:, TICK_SPEED_WALK] = np.where(guided, guess.walk_m2_s3 + noise * s.tick_s, 0.0)
        values[:, TICK_SPEED_WALK] += blocks.shock[here] * s.shock_speed_m_s**2 / s.tick_s
        values[:, TICK_SLIP_VARIANCE] = slip
        self.watch.doubt(blocks.t_ns[here], (doubt == 1.0) & wheels_ok & ~still)
        values[:, TICK_REST_VARIANCE] = np.where(guided | still, guess.rest_variance_m2_s4, 0.0)
        return self._tilt_held(values)

    def _tilt_held(self, values: Float64Array) -> Float64Array:
        """Hold the last tilt, as uncertain as it then is, where there is none."""
        for row in values:
            if np.isfinite(row[:6]).all():
                self._last_tilt = row[:2].copy()
            else:
                row[:6] = [*self._last_tilt, 0.0, 0.0, *[self._settings.tilt_lost_rad**2] * 2]
        return values

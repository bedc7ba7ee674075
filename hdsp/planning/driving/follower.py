"""A controller that carries out a timed motion in the simulation.

Wheels turn at the speed that the motion wants and correct their own positions; legs hold the feet against the base.
A quadratic programme distributes weight and base corrections on the wheels that carry (`contact_forces`). The motion's
time stands still while the robot lags behind, while a wheel steers, and until a foot that leaves or comes to carry has
lost or taken its load.
"""

from __future__ import annotations

import numpy as np

from hdsp.detailed.motion.phases import PHASES
from hdsp.planning.driving.contact_forces import ContactForces
from hdsp.planning.driving.pose_estimate import BasePose, PoseEstimate
from hdsp.planning.driving.reference import STEP, Reference, Wanted
from hdsp.planning.driving.robot_model import GRAVITY
from hdsp.planning.driving.simulated_robot import SimulatedRobot

_SHIFT_LOAD = 0.2  # s, in which a wheel loses or takes its load
_LAG = 0.03, 0.08  # m; errors at which the motion's time slows down, and stands still
_TURNED = 0.08, 0.3  # rad; the same for heading and steering
_SPEED_UP, _SLOW_DOWN = 2.0, 4.0  # 1/s; change of the motion's speed, as a share of its own
_TOUCH = 0.04  # of the weight; a foot with this force has touched the ground
_FEEL = 0.05  # m/s, of a foot that feels for the ground below the planned one
_RELAX = 2.0  # 1/s
_FORGET = 0.1  # m, of rolling, in which a foot's deviation from its planned place is corrected
_SOFT = 0.03  # stiffness of a carrying leg along its length, as a share
_HOLD = 3.0  # 1/s, gain of position errors of rolling wheels
_AIM = 3.0  # 1/s, lateral error of a wheel by steering
_TURN = 3.0  # 1/s, heading error by the wheels
_MOST_CORRECTION = 0.15  # m/s
_ASIDE = 2.0  # rad/m, heading by which wheels that do not steer return to the path
_BEND, _BEND_RATE = 0.25, 0.4  # rad, rad/s; largest deviation from the planned heading, and its change
_MOST_ASIDE = 0.15  # m, of a foot beside its planned foothold
_STRAIGHTEN = 0.5  # m before the end of a drive, in which the deviation shrinks
_BALANCE = 4.0  # 1/s, gain of deviations of the centre of mass
_SLOWLY = 0.5  # 1/s, the same on three feet: a quick push of the base would first tip the robot the other way
_RESERVE = 0.02  # m, beyond the robot's own margin, before a foot leaves the ground
_MOST_SHIFT = 0.08  # m
_UNSAFE = 0.01  # m; a foot leaves the ground when no more of the margin is lacking,
_PATIENCE = 4.0  # s, or after so long
_GRIP = 0.85  # of the friction coefficient, that slope and accelerations together may take
_STEEP_RATE = 0.3  # least speed of the motion on steep ground, as a share of its own
_SLOWEST = 0.03  # m/s; slower wheels do not correct lateral errors by steering


class Follower:
    """Carries out a motion.

    Attributes:
        time: moment of the motion, s.
        load: float64 [4] in [0, 1], share of load that each wheel may take.
        wanted: wanted state at that moment.
        feeling: float64 [4], depths below the planned ground at which feet look for ground, m.
    """

    def __init__(self, simulated: SimulatedRobot, reference: Reference, random: np.random.Generator):
        self._sim, self._reference = simulated, reference
        size, robot = simulated.size, simulated.robot
        self._forces = ContactForces(size.friction, size.leg_force, robot.feet.neutral_x)
        self._estimate = PoseEstimate(simulated.base_place(), random)
        self._height_gain = size.weight / 0.03, 1.4 * np.sqrt(size.weight / 0.03 * size.mass)
        lever = robot.feet.neutral_x * robot.feet.neutral_y
        inertia = simulated.model.body_inertia[simulated.base_body].max()
        self._lean_gain = size.weight * lever / 0.03, 1.4 * np.sqrt(size.weight * lever / 0.03 * inertia)
        self.time, self._rate = 0.0, 0.0
        self.wanted = reference.at(0.0)
        self.load = np.ones(4)
        self._offset = np.zeros((4, 3))  # of feet from their planned places, in the heading frame
        self._standing = np.zeros(4, bool)
        self._rolled = np.zeros(4)  # m, since the wheel stands
        self._steer = self.wanted.steering.copy()
        self._scrub = 0.0  # integrated heading error, for wheels that skid
        self._lacking, self._waited = 0.0, 0.0  # m, of the margin; s, before a foot leaves or comes to carry
        self._shift = np.zeros(2)  # of the base, for the balance, m
        self._turned = 0.0  # heading beside the planned one, by which wheels that do not steer go sideways

    @property
    def done(self) -> bool:
        return self.time >= self._reference.duration

    @property
    def feeling(self) -> np.ndarray:
        return np.where(self.wanted.carries, 0.0, np.maximum(-self._offset[:, 2], 0.0))

    @property
    def labels(self) -> tuple[int, int]:
        """Phase and action."""
        return self._reference.labels(self.time)

    @property
    def standing(self) -> np.ndarray:
        """Whether each wheel stands on the ground, bool [4]."""
        return self._standing & (self.load > 0.99)

    def control(self, elapsed: float, hold: bool = False) -> None:
        """Sets the motors for the next ``elapsed`` s; with ``hold``, the motion's time stands still."""
        sim = self._sim
        slides, slide_speeds = sim.slides()
        forces, _ = sim.contacts()
        pose = self._pose(slides, slide_speeds, elapsed)
        self._bend(pose, elapsed)
        wanted = self._bent(self.wanted)
        feet = sim.feet_from(pose.place, pose.rotation, slides)
        goal = wanted.feet + self._offset @ _about_z(wanted.base[5]).T
        self._steer_toward(wanted, goal - feet, pose, elapsed)
        self._stand(wanted, feet, pose, forces, elapsed)
        self._balance(wanted, pose, feet, goal, elapsed)
        if not hold:
            self._advance(wanted, pose, feet, goal, forces, elapsed)
        aim, rate = self._leg_targets(wanted, pose, goal)
        stiffness = self._stiffness()
        push = stiffness * (aim - slides) + sim.size.damping * (rate - slide_speeds)
        springs = self._spring_forces(pose, push)
        carried = self._ground_forces(wanted, pose, feet, springs)
        forward = (np.array([0.0, 0.0, sim.size.leg_mass * GRAVITY]) - carried) @ pose.rotation
        sim.model.actuator_biasprm[sim.slide_motors, 1] = -stiffness
        sim.data.ctrl[sim.slide_motors] = forward + stiffness * aim + sim.size.damping * rate
        self._drive_wheels(wanted, pose, goal - feet, carried + springs, elapsed)

    def _bend(self, pose: BasePose, elapsed: float) -> None:
        """Turns the heading beside the planned one, so that wheels that do not steer return to the planned path."""
        wanted = self.wanted
        if self._sim.size.steers or not wanted.moves.all():
            return
        cos, sin = np.cos(wanted.base[5]), np.sin(wanted.base[5])
        vx, vy = wanted.base_velocity[:2]
        ex, ey = wanted.base[:2] - pose.place[:2]
        along, across, aside = cos * vx + sin * vy, cos * vy - sin * vx, cos * ey - sin * ex
        target = 0.0
        if abs(along) > _SLOWEST:
            most = _BEND * min(1.0, wanted.left / _STRAIGHTEN)
            target = float(np.clip(np.arctan2(across, abs(along)) + _ASIDE * aside, -most, most) * np.sign(along))
        most = self._rate * _BEND_RATE * elapsed
        self._turned += float(np.clip(target - self._turned, -most, most))

    def _bent(self, wanted: Wanted) -> Wanted:
        """Turns the wanted state about its base; feet in the air keep their planned places."""
        if not self._turned:
            return wanted
        base = wanted.base.copy()
        base[5] += self._turned
        turned = (wanted.feet - base[:3]) @ _about_z(self._turned).T + base[:3]
        feet = np.where(wanted.carries[:, None], turned, wanted.feet)
        return wanted._replace(base=base, feet=feet)

    def _balance(self, wanted: Wanted, pose: BasePose, feet, goal, elapsed: float) -> None:
        """Shifts the base until the centre of mass is where the motion has it, relative to the feet that carry."""
        carrying = self.load > 0.5
        stance = self._sim.robot.stance
        planned = wanted.base[:3] + _rotation(wanted.base) @ np.array([stance.mass_x, 0.0, stance.mass_z])
        off = (planned - goal[carrying].mean(axis=0)) - (
            self._sim.center_of_mass() - self._sim.feet()[carrying].mean(axis=0)
        )
        change, _, carries = self._next_change(wanted)
        remain = wanted.carries & carries if change else wanted.carries
        inward = _inward(self._sim.feet()[remain, :2], self._sim.center_of_mass()[:2], stance.margin + _RESERVE)
        self._lacking = float(np.linalg.norm(inward))
        if wanted.moves.any():
            self._shift *= 1 - min(1.0, 2.0 * self._rate * elapsed)
        else:
            nearer = off[:2] if self._lacking == 0 else inward
            gain = _BALANCE if (self.load > 0).all() else _SLOWLY
            self._shift = np.clip(self._shift + gain * elapsed * nearer, -_MOST_SHIFT, _MOST_SHIFT)

    def _pose(self, slides: np.ndarray, speeds: np.ndarray, elapsed: float) -> BasePose:
        sim = self._sim
        true = BasePose(sim.base_place(), sim.rotation(), sim.velocity(), sim.turn_rate())
        rotation, rate = true.rotation, true.turn_rate
        ahead = self._ahead(rotation)
        pitch_rate = rate @ rotation[:, 1]
        rolls = (sim.spin_speeds() + pitch_rate)[:, None] * sim.size.radius * ahead
        arms = (slides + sim.robot.hips()) @ rotation.T
        odometry = (rolls - speeds @ rotation.T - np.cross(rate, arms))[self.load > 0.5].mean(axis=0)
        return self._estimate.update(true, odometry, elapsed)

    def _ahead(self, rotation: np.ndarray) -> np.ndarray:
        """Directions in which the wheels roll, float64 [4, 3], world frame."""
        angle = self._sim.steering()
        return np.stack([np.cos(angle), np.sin(angle), np.zeros(4)], axis=1) @ rotation.T

    def _steer_toward(self, wanted: Wanted, error: np.ndarray, pose: BasePose, elapsed: float) -> None:
        """Turns wanted wheel directions to the nearer end of each wheel, at most as fast as wheels steer."""
        if not self._sim.size.steers:
            return
        aim = wanted.steering.copy()
        velocity = self._rate * wanted.feet_velocity[:, :2] + np.clip(_AIM * error[:, :2], -0.1, 0.1)
        corrected = np.arctan2(velocity[:, 1], velocity[:, 0]) - wanted.base[5]
        fast = wanted.moves & (np.linalg.norm(wanted.feet_velocity[:, :2], axis=1) * self._rate > _SLOWEST)
        bent = _half_turn(corrected - aim)
        aim = np.where(fast, aim + np.clip(bent, -0.25, 0.25), aim)
        most = self._sim.robot.physics.steer_speed * elapsed
        self._steer += np.clip(_half_turn(aim - self._steer), -most, most)

    def _stand(self, wanted: Wanted, feet: np.ndarray, pose: BasePose, forces: np.ndarray, elapsed: float) -> None:
        """Remembers where wheels come to rest; lets rolling wheels return to their planned places."""
        sim = self._sim
        stands = (self.load > 0) & ~(wanted.moves & wanted.carries)
        begins = stands & ~self._standing
        planned = (wanted.feet - wanted.base[:3] - np.array([*self._shift, 0.0])) @ _rotation(wanted.base)
        actual = (feet - pose.place) @ pose.rotation
        deviation = (actual - planned) @ _rotation(wanted.base).T @ _about_z(wanted.base[5])
        self._offset[begins] = deviation[begins]
        self._rolled[begins] = 0.0
        if stands.any():  # feet that pull against each other relax
            strain = deviation[stands] - self._offset[stands]
            self._offset[stands] += min(1.0, _RELAX * elapsed) * (strain - strain.mean(axis=0))
        lifts = self._standing & (self.load == 0)
        away = (feet - wanted.feet) @ _about_z(wanted.base[5])
        self._offset[lifts] = away[lifts]
        self._standing = stands
        pitch_rate = pose.turn_rate @ pose.rotation[:, 1]
        self._rolled += sim.size.radius * (sim.spin_speeds() + pitch_rate) * elapsed
        moving = wanted.moves
        way = np.linalg.norm(wanted.feet_velocity[:, :2], axis=1) * self._rate * elapsed
        self._offset[moving] *= np.exp(-way[moving] / _FORGET)[:, None]
        lowering = ~wanted.carries & (self.labels[0] == PHASES.index("lower"))
        touched = lowering & (forces[:, 2] > _TOUCH * sim.size.weight)
        self._offset[touched, 2] = np.maximum(self._offset[touched, 2], feet[touched, 2] - wanted.feet[touched, 2])
        swinging = ~wanted.carries & ~lowering
        if swinging.any():
            aside = 0.0
            if not sim.size.steers:  # the whole robot is beside its path, and the foot stays with it
                aside = float(np.clip(self._offset[stands, 1].mean(), -_MOST_ASIDE, _MOST_ASIDE))
            self._offset[swinging] += min(1.0, 5.0 * elapsed) * (np.array([0.0, aside, 0.0]) - self._offset[swinging])

    def _advance(self, wanted: Wanted, pose: BasePose, feet, goal, forces: np.ndarray, elapsed: float) -> None:
        """Moves loads and the motion's time on."""
        reference, sim = self._reference, self._sim
        at_change, limit, carries = self._next_change(wanted)
        before = limit - 1.01 * STEP if limit in reference.changes else limit
        landing = carries & ~wanted.carries
        self._waited = self._waited + elapsed if at_change else 0.0
        unsafe = self._lacking > _UNSAFE and self._waited < _PATIENCE and not landing.any() and (self.load == 1).all()
        target = (wanted.carries & (carries | unsafe)).astype(float)
        step = elapsed / _SHIFT_LOAD
        self.load += np.clip(target - self.load, -step, step)
        ready = bool((self.load == target).all()) and not unsafe
        if landing.any():
            feel = landing & ~(forces[:, 2] > _TOUCH * sim.size.weight)
            self._offset[feel, 2] -= _FEEL * elapsed
            ready &= not feel.any()
        self._rate = self._new_rate(wanted, pose, feet, goal, elapsed)
        if at_change and ready:
            self.time = limit
        elif ready:
            self.time = min(self.time + elapsed * self._rate, max(before, self.time))
        self.wanted = reference.at(self.time)

    def _next_change(self, wanted: Wanted) -> tuple[bool, float, np.ndarray]:
        """Whether feet are about to leave or to carry, when, and the feet that carry then; else the end of the motion.

        The last moment with the present feet is a sample before the change.
        """
        reference = self._reference
        following = reference.changes[reference.changes > self.time + 1e-9]
        if not len(following):
            return False, reference.duration, wanted.carries
        limit = float(following[0])
        near = self.time >= limit - 1.01 * STEP - 1e-9
        return near, limit, reference.at(limit).carries if near else wanted.carries

    def _new_rate(self, wanted: Wanted, pose: BasePose, feet, goal, elapsed: float) -> float:
        ahead = self._ahead(pose.rotation)
        onward = np.sign((wanted.feet_velocity * ahead).sum(axis=1))
        behind = onward * ((goal - feet) * ahead).sum(axis=1)
        share = _share(float(np.where(wanted.moves, behind, 0.0).max()), *_LAG)
        heading = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])
        if wanted.moves.all():
            share = min(share, _share(abs(_whole_turn(wanted.base[5] - heading)), *_TURNED))
        if self._sim.size.steers and wanted.moves.any():
            off = np.abs(_half_turn(wanted.steering - self._sim.steering()))[wanted.moves].max()
            share = min(share, _share(off, 0.15, 0.4))
        share = min(share, self._grip_rate(wanted))
        return float(np.clip(share, self._rate - _SLOW_DOWN * elapsed, self._rate + _SPEED_UP * elapsed))

    def _grip_rate(self, wanted: Wanted) -> float:
        """Speed of the motion at which its largest acceleration takes the friction that the slope leaves."""
        size, robot = self._sim.size, self._sim.robot
        slope = np.arctan(np.hypot(*np.tan(wanted.base[3:5])))
        left = GRAVITY * (_GRIP * size.friction * np.cos(slope) - np.sin(slope))
        return float(np.sqrt(np.clip(left / robot.accelerations.drive, _STEEP_RATE**2, 1.0)))

    def _spring_forces(self, pose: BasePose, push: np.ndarray) -> np.ndarray:
        """Ground forces that answer the push of the slides along and across the base, float64 [4, 3], N."""
        along = push * (self.load > 0)[:, None] * np.array([1.0, 1.0, 0.0])
        most = 0.2 * self._sim.size.weight
        return -np.clip(along, -most, most) @ pose.rotation.T

    def _ground_forces(self, wanted: Wanted, pose: BasePose, feet: np.ndarray, springs: np.ndarray) -> np.ndarray:
        """Ground forces beside those of the springs: they carry the weight, and hold height and lean."""
        sim = self._sim
        center = sim.center_of_mass()
        tipping = np.cross(feet - center, springs).sum(axis=0)
        stiff, damp = self._height_gain
        up = stiff * (wanted.base[2] - pose.place[2]) + damp * (self._rate * wanted.base_velocity[2] - pose.velocity[2])
        up = np.clip(up, -0.3 * sim.size.weight, 0.3 * sim.size.weight)
        heading = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])
        target = _rotation(np.array([0, 0, 0, wanted.base[3], wanted.base[4], heading]))
        off = target @ pose.rotation.T
        lean = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], 0.0])
        stiff, damp = self._lean_gain
        torque = stiff * lean - damp * pose.turn_rate * np.array([1, 1, 0])
        lift = sim.size.weight + up - springs[:, 2].sum()
        wrench = np.array([0.0, 0.0, lift, *(torque - tipping * np.array([1, 1, 0]))])
        return self._forces(feet, center, wrench, self.load)

    def _leg_targets(self, wanted: Wanted, pose: BasePose, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Wanted positions and speeds of the leg joints, float64 [4, 3] each."""
        sim = self._sim
        rotation = _rotation(wanted.base)
        place = wanted.base[:3] + np.array([*self._shift, 0.0])
        shape = sim.slides_for(place, rotation, goal)
        placed = sim.slides_for(pose.place, pose.rotation, goal)
        aim = np.where(self.load[:, None] > 0, shape, placed)
        rate = self._rate * (wanted.feet_velocity - wanted.base_velocity[:3]) @ rotation
        arm = aim + sim.robot.hips()
        spin = self._rate * wanted.base_velocity[5]
        return aim, rate + spin * np.stack([arm[:, 1], -arm[:, 0], np.zeros(4)], axis=1)

    def _stiffness(self) -> np.ndarray:
        stiffness = np.full((4, 3), self._sim.size.stiffness)
        stiffness[:, 2] *= np.where(self.load > 0, _SOFT, 1.0)
        stiffness[:, 1] *= 0.5
        return stiffness

    def _drive_wheels(self, wanted: Wanted, pose: BasePose, error, ground: np.ndarray, elapsed: float) -> None:
        sim, size = self._sim, self._sim.size
        ahead = self._ahead(pose.rotation)
        correction = np.clip(_HOLD * (error * ahead).sum(axis=1), -_MOST_CORRECTION, _MOST_CORRECTION)
        speed = self._rate * (wanted.feet_velocity * ahead).sum(axis=1) + correction
        heading = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])
        off = _whole_turn(wanted.base[5] - heading)
        if not wanted.moves.all():
            self._scrub = 0.0  # what one drive needed to turn would skid the wheels of the next one
        elif not size.steers:
            self._scrub = float(np.clip(self._scrub + 6.0 * off * elapsed, -1.0, 1.0))
            arm = sim.robot.feet.neutral_y * np.array([-1.0, -1.0, 1.0, 1.0])
            lever = np.hypot(sim.robot.feet.neutral_x, sim.robot.feet.neutral_y) / sim.robot.feet.neutral_y
            turning = self._rate * wanted.base_velocity[5] * (lever**2 - 1) + (_TURN * off + self._scrub) * lever
            speed += arm * turning
        speed = np.where(wanted.moves, speed, 0.0)
        pitch_rate = pose.turn_rate @ pose.rotation[:, 1]
        torque = size.radius * (ground * ahead).sum(axis=1)
        hold = np.where(self._standing, -20.0 * self._rolled / size.radius, 0.0)
        sim.data.ctrl[sim.wheel_motors] = torque + size.wheel_gain * (speed / size.radius - pitch_rate + hold)
        if size.steers:
            gain = -sim.model.actuator_biasprm[sim.steering_motors, 1]
            sim.data.ctrl[sim.steering_motors] = gain * self._steer


def _inward(feet: np.ndarray, point: np.ndarray, margin: float) -> np.ndarray:
    """Way, float64 [2], m, on which a point gets a margin to the edges of a polygon [n, 2], counter-clockwise."""
    edges = np.roll(feet, -1, axis=0) - feet
    left = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    lacking = np.maximum(margin - ((point - feet) * left).sum(axis=1), 0.0)
    return lacking @ left


def _share(value: float, begin: float, end: float) -> float:
    return float(np.clip((end - value) / (end - begin), 0.0, 1.0))


def _half_turn(angle):
    """Angles between lines, in [-pi / 2, pi / 2)."""
    return (angle + np.pi / 2) % np.pi - np.pi / 2


def _whole_turn(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _about_z(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])


def _rotation(base: np.ndarray) -> np.ndarray:
    roll, pitch, heading = base[3:6]
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    lean = np.array([(cp, sp * sr, sp * cr), (0.0, cr, -sr), (-sp, cp * sr, cp * cr)])
    return _about_z(heading) @ lean

"""Random courses, and patches cut from their scans."""

from dataclasses import replace

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.labels.course_patches import CoursePatchSettings, PatchRun, simulated_courses, task_set
from hdsp.labels.rules import LabelSettings
from hdsp.robot.robot import Robot
from hdsp.terrain.obstacles import Ramp, Staircase
from hdsp.terrain.simulation.courses import CourseSettings, random_course
from hdsp.terrain.simulation.lidar import Lidar


@pytest.mark.parametrize("index", range(4))
def test_a_course_has_all_it_should(index):
    course = random_course(5, index)
    kinds = [type(obstacle) for obstacle in course.arena.scene.obstacles]
    assert kinds.count(Staircase) == 1 and kinds.count(Ramp) == 1
    assert {place.kind for place in course.places} == {"door", "stairs", "ramp", "platform", "clutter", "open"}
    heights = course.arena.height_map()
    assert heights.size == (6.0, 6.0)
    assert heights.height_at(*course.start) == 0.0
    assert random_course(5, index) == course
    assert random_course(6, index) != course


def test_wrong_settings_are_named():
    with pytest.raises(InputError, match="size is 3"):
        CourseSettings(size=3.0)
    with pytest.raises(InputError, match="rise is"):
        CourseSettings(rise=(0.3, 0.2))
    with pytest.raises(InputError, match="course seed -1"):
        random_course(-1, 0)
    with pytest.raises(InputError, match=r"PatchSettings\.courses is 0"):
        CoursePatchSettings(seed=1, courses=0, patches_per_course=1)
    with pytest.raises(InputError, match=r"heading_residues\[0\] is 7; need less than 4"):
        CoursePatchSettings(seed=1, courses=1, patches_per_course=1, heading_residues=(7,))


def test_patches_are_cut_from_the_scan_and_labelled():
    pytest.importorskip("mujoco")
    lidar = Lidar(azimuth_step=0.05, speed=1.5)
    labels = LabelSettings(max_expansions=300)
    run = PatchRun(CoursePatchSettings(1, 1, 4, (0, 1)), CourseSettings(), lidar, Robot.load("momaro"), labels)
    (course,) = simulated_courses(run)
    tasks = task_set(run, [course])
    assert len(tasks) == 4 == len(set(tasks.category)), "one of each kind before the second of any"
    assert tasks.heading.tolist() == [0, 4, 0, 4]
    for patch, heights in zip(course.patches, tasks.heights, strict=True):
        cell = np.floor(np.array(patch.start[:2]) / 0.025).astype(int)
        np.testing.assert_array_equal(course.terrain.crop_cells(*cell, patch.start[2]).heights, heights)
    more = replace(run, patches=replace(run.patches, courses=2, patches_per_course=30))
    (again,) = simulated_courses(more, numbers=[0])
    assert len(again.course.places) < len(again.patches) <= 30, "places give several"
    assert [patch.start for patch in again.patches[:4]] == [patch.start for patch in course.patches]
    longer = replace(more, patches=replace(more.patches, courses=7))
    assert longer.course_hash() == more.course_hash() != run.course_hash()
    assert run.hash() != PatchRun(CoursePatchSettings(2, 1, 4), run.courses, lidar, run.robot, labels).hash()
    assert len(task_set(run, [])) == 0

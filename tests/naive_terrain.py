"""Slow, simple twins of patches and rasterised obstacles: one cell at a time, from the definitions."""

import math

import numpy as np


def crop(heights, origin, resolution, pose, cells):
    """Patch cell (i, j) is the map cell that contains base + R(theta) * (i - c, j - c) * resolution."""
    x, y, theta = pose
    patch = np.full((cells, cells), np.nan, np.float32)
    for i in range(cells):
        for j in range(cells):
            ahead, left = (i - cells // 2) * resolution, (j - cells // 2) * resolution
            px = x + math.cos(theta) * ahead - math.sin(theta) * left
            py = y + math.sin(theta) * ahead + math.cos(theta) * left
            ix, iy = math.floor((px - origin[0]) / resolution), math.floor((py - origin[1]) / resolution)
            if 0 <= ix < heights.shape[0] and 0 <= iy < heights.shape[1]:
                patch[i, j] = heights[ix, iy]
    return patch


def block_covers(block, x, y):
    """A point is on a block if it lies between both pairs of opposite sides."""
    ahead = math.cos(block.yaw), math.sin(block.yaw)
    along = (x - block.x) * ahead[0] + (y - block.y) * ahead[1]
    across = (y - block.y) * ahead[0] - (x - block.x) * ahead[1]
    return abs(along) <= block.length / 2 + 1e-9 and abs(across) <= block.width / 2 + 1e-9


def staircase_height(stairs, x, y):
    """The n-th step begins n - 1 treads behind the first riser and is ``depth`` long; the highest step counts."""
    ahead = math.cos(stairs.yaw), math.sin(stairs.yaw)
    along = (x - stairs.x) * ahead[0] + (y - stairs.y) * ahead[1]
    across = (y - stairs.y) * ahead[0] - (x - stairs.x) * ahead[1]
    height = 0.0
    for step in range(1, stairs.steps + 1):
        begin = (step - 1) * stairs.tread
        if abs(across) <= stairs.width / 2 and begin <= along <= begin + stairs.depth:
            height = step * stairs.rise
    return height

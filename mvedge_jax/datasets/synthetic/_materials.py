"""Surfaces that several scenes share."""

from .world import Material

BRICK = Material(
    dark=(0.47, 0.25, 0.18),
    light=(0.74, 0.47, 0.36),
    accent=(0.68, 0.66, 0.61),
    contrast=0.8,
    pattern="bricks",
    size=0.26,
    aspect=2.6,
    tint=0.55,
    grain=0.2,
    gain=0.75,
)
PLASTER = Material(dark=(0.5, 0.47, 0.42), light=(0.86, 0.82, 0.75), grain=0.6, gain=0.73)
SLATE = Material(dark=(0.16, 0.19, 0.21), light=(0.46, 0.5, 0.52), grain=0.5, gain=0.7)
MOSS = Material(dark=(0.12, 0.2, 0.07), light=(0.55, 0.62, 0.3), grain=0.3, gain=0.75)
SAND = Material(dark=(0.5, 0.38, 0.22), light=(0.88, 0.77, 0.56), grain=0.25, gain=0.75)
WOOD = Material(
    dark=(0.33, 0.18, 0.09),
    light=(0.74, 0.52, 0.31),
    accent=(0.13, 0.07, 0.04),
    grain=0.09,
    stretch=(9.0, 1.0, 1.0),
    pattern="bricks",
    size=0.3,
    aspect=7.0,
    tint=0.5,
)
MARBLE = Material(
    dark=(0.42, 0.45, 0.48), light=(0.95, 0.93, 0.9), contrast=1.2, grain=0.4, gain=0.68
)
RED = Material(
    dark=(0.45, 0.06, 0.05), light=(0.8, 0.25, 0.18), grain=0.25, gain=0.72, contrast=0.8
)
BLUE = Material(
    dark=(0.07, 0.16, 0.36), light=(0.35, 0.55, 0.78), grain=0.25, gain=0.72, contrast=0.9
)
OCHRE = Material(
    dark=(0.55, 0.36, 0.07), light=(0.93, 0.73, 0.3), grain=0.2, gain=0.72, contrast=0.8
)
CHECKS = Material(
    dark=(0.6, 0.57, 0.5),
    light=(0.92, 0.9, 0.84),
    accent=(0.12, 0.2, 0.24),
    pattern="checks",
    size=0.16,
    grain=0.3,
    tint=0.15,
)
DOTS = Material(
    dark=(0.62, 0.2, 0.16),
    light=(0.85, 0.4, 0.3),
    accent=(0.95, 0.9, 0.8),
    pattern="dots",
    size=0.14,
    grain=0.3,
)
STRIPES = Material(
    dark=(0.1, 0.3, 0.32),
    light=(0.3, 0.55, 0.55),
    accent=(0.93, 0.88, 0.76),
    pattern="stripes",
    size=0.13,
    grain=0.3,
)

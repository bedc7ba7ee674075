"""Colours of all pictures, as figures and in the browser."""

# Okabe and Ito's colours: people with the common colour vision deficiencies can tell them apart.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY, RED = "#8A8A8A", "#B2182B"

START, GOAL = BLUE, VERMILLION
FEET = (SKY, GREEN, YELLOW, PURPLE)

UNKNOWN = "#F3D9E4"
#: Colours of heights, from the lowest to the highest.
HEIGHT_COLORS = "#F7F7F4", "#CFCBBE", "#9E9683", "#6B6455", "#3B362E"
#: The same in three dimensions, where light and shade show the shape: sage, sand, camel, brown, slate.
GROUND_COLORS = "#A3B49A", "#DCD2B2", "#C8A26F", "#96704F", "#6F747C"

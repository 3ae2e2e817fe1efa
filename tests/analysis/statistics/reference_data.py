"""Data sets with published results, from R's own package `datasets` where nothing else is said."""

from __future__ import annotations

import pandas as pd

from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData

# R: PlantGrowth (Dobson 1983)
PLANT_GROWTH = {
    "ctrl": [4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14],
    "trt1": [4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69],
    "trt2": [6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26],
}

# R: InsectSprays (Beall 1942)
INSECT_SPRAYS = {
    "A": [10, 7, 20, 14, 14, 12, 10, 23, 17, 20, 14, 13],
    "B": [11, 17, 21, 11, 16, 14, 17, 17, 19, 21, 7, 13],
    "C": [0, 1, 7, 2, 3, 1, 2, 1, 3, 0, 1, 4],
    "D": [3, 5, 12, 6, 4, 3, 5, 5, 5, 5, 2, 4],
    "E": [3, 5, 3, 5, 3, 6, 1, 1, 3, 2, 6, 4],
    "F": [11, 9, 15, 22, 15, 16, 13, 10, 26, 26, 24, 13],
}

# R: the data set chickwts
CHICK_WEIGHTS = {
    "casein": [368, 390, 379, 260, 404, 318, 352, 359, 216, 222, 283, 332],
    "horsebean": [179, 160, 136, 227, 217, 168, 108, 124, 143, 140],
    "linseed": [309, 229, 181, 141, 260, 203, 148, 169, 213, 257, 244, 271],
    "meatmeal": [325, 257, 303, 315, 380, 153, 263, 242, 206, 344, 258],
    "soybean": [243, 230, 248, 327, 329, 250, 193, 271, 316, 267, 199, 171, 158, 248],
    "sunflower": [423, 340, 392, 339, 341, 226, 320, 295, 334, 322, 297, 318],
}

# R: airquality, Ozone by Month; days without a value left out
AIR_QUALITY = {
    "May": [
        *(41, 36, 12, 18, 28, 23, 19, 8, 7, 16, 11, 14, 18, 14, 34, 6, 30, 11, 1, 11, 4, 32, 23, 45, 115, 37),
    ],
    "Jun": [29, 71, 39, 23, 21, 37, 20, 12, 13],
    "Jul": [
        *(135, 49, 32, 64, 40, 77, 97, 97, 85, 10, 27, 7, 48, 35, 61, 79, 63, 16, 80, 108, 20, 52, 82, 50, 64, 59),
    ],
    "Aug": [
        *(39, 9, 16, 78, 35, 66, 122, 89, 110, 44, 28, 65, 22, 59, 23, 31, 44, 21, 9, 45, 168, 73, 76, 118, 84, 85),
    ],
    "Sep": [
        *(96, 78, 73, 91, 47, 32, 20, 23, 21, 24, 44, 21, 28, 9, 13, 46, 18, 13, 24, 16, 13, 23, 36, 7, 14, 30),
        *(14, 18, 20),
    ],
}

# R: sleep (Student 1908); extra hours of sleep of ten patients under two drugs
SLEEP = {
    "1": [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0],
    "2": [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4],
}

# R, ?wilcox.test (Hollander and Wolfe 1973): depression factor of nine patients, and permeability of amnion
DEPRESSION = {
    "first": [1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30],
    "second": [0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29],
}
PERMEABILITY = {
    "at term": [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46],
    "early": [1.15, 0.88, 0.90, 0.74, 1.21],
}

# R, ?cor.test (Hollander and Wolfe 1973): colour and quality of canned tuna
TUNA = {
    "colour": [44.4, 45.9, 41.9, 53.3, 44.7, 44.1, 50.7, 45.2, 60.1],
    "quality": [2.6, 3.1, 2.5, 5.0, 3.6, 4.0, 5.2, 2.8, 3.8],
}

# R: npk (Venables and Ripley 2002); for each block the plots, as N, P, K and yield
NPK = (
    ("011 49.5", "110 62.8", "000 46.8", "101 57.0"),
    ("100 59.8", "111 58.5", "001 55.5", "010 56.0"),
    ("010 62.8", "111 55.8", "100 69.5", "001 55.0"),
    ("100 62.0", "111 48.8", "001 45.5", "010 44.2"),
    ("110 52.0", "000 51.5", "101 49.8", "011 48.8"),
    ("101 57.2", "110 59.0", "011 53.2", "000 56.0"),
)

# R: mtcars, mpg by transmission (automatic, manual)
MILES_PER_GALLON = {
    "automatic": [
        *(21.4, 18.7, 18.1, 14.3, 24.4, 22.8, 19.2, 17.8, 16.4, 17.3, 15.2, 10.4, 10.4, 14.7, 21.5, 15.5, 15.2, 13.3),
        19.2,
    ],
    "manual": [21.0, 21.0, 22.8, 32.4, 30.4, 33.9, 27.3, 26.0, 30.4, 15.8, 19.7, 15.0, 21.4],
}

# R: ToothGrowth (Crampton 1947), by supplement and dose
TOOTH_GROWTH = {
    ("VC", "0.5"): [4.2, 11.5, 7.3, 5.8, 6.4, 10, 11.2, 11.2, 5.2, 7],
    ("VC", "1"): [16.5, 16.5, 15.2, 17.3, 22.5, 17.3, 13.6, 14.5, 18.8, 15.5],
    ("VC", "2"): [23.6, 18.5, 33.9, 25.5, 26.4, 32.5, 26.7, 21.5, 23.3, 29.5],
    ("OJ", "0.5"): [15.2, 21.5, 17.6, 9.7, 14.5, 10, 8.2, 9.4, 16.5, 9.7],
    ("OJ", "1"): [19.7, 23.3, 23.6, 26.4, 20, 25.2, 25.8, 21.2, 14.5, 27.3],
    ("OJ", "2"): [25.5, 26.4, 22.4, 24.5, 24.8, 30.9, 26.4, 27.3, 29.4, 23],
}

# R: warpbreaks (Tippett 1950), by wool and tension
WARP_BREAKS = {
    ("A", "L"): [26, 30, 54, 25, 70, 52, 51, 26, 67],
    ("A", "M"): [18, 21, 29, 17, 12, 18, 35, 30, 36],
    ("A", "H"): [36, 21, 24, 18, 10, 43, 28, 15, 26],
    ("B", "L"): [27, 14, 29, 19, 29, 31, 41, 20, 44],
    ("B", "M"): [42, 26, 19, 16, 39, 28, 21, 39, 29],
    ("B", "H"): [20, 21, 24, 17, 13, 15, 15, 16, 28],
}

# R: nlme, ergoStool; effort of nine subjects to rise from four types of stools
ERGO_STOOL = {
    "T1": [12, 10, 7, 7, 8, 9, 8, 7, 9],
    "T2": [15, 14, 14, 11, 11, 11, 12, 11, 13],
    "T3": [12, 13, 13, 10, 8, 11, 12, 8, 10],
    "T4": [10, 12, 9, 9, 7, 10, 11, 7, 8],
}

# R: friedman.test, example RoundingTimes (Hollander and Wolfe 1973, p. 140); 22 players, three ways to round first base
ROUNDING_TIMES = {
    "Round Out": [
        *(5.40, 5.85, 5.20, 5.55, 5.90, 5.45, 5.40, 5.45, 5.25, 5.85, 5.25, 5.65, 5.60, 5.05, 5.50, 5.45, 5.55, 5.45),
        *(5.50, 5.65, 5.70, 6.30),
    ],
    "Narrow Angle": [
        *(5.50, 5.70, 5.60, 5.50, 5.85, 5.55, 5.40, 5.50, 5.15, 5.80, 5.20, 5.55, 5.35, 5.00, 5.50, 5.55, 5.55, 5.50),
        *(5.45, 5.60, 5.65, 6.30),
    ],
    "Wide Angle": [
        *(5.55, 5.75, 5.50, 5.40, 5.70, 5.60, 5.35, 5.35, 5.00, 5.70, 5.10, 5.45, 5.45, 4.95, 5.40, 5.50, 5.35, 5.55),
        *(5.25, 5.40, 5.55, 6.25),
    ],
}

# Higgins, Blair and Tashtoush 1990, table 1, as in the R package ARTool (Higgins1990Table1), by row and column
HIGGINS_TABLE_1 = {
    ("r1", "c1"): [11.5, 10.1, 9.9, 10.6],
    ("r1", "c2"): [9.0, 7.4, 8.8, 8.8],
    ("r1", "c3"): [3.8, 6.3, 4.9, 5.3],
    ("r2", "c1"): [9.9, 9.8, 9.3, 9.1],
    ("r2", "c2"): [9.3, 7.4, 7.7, 7.9],
    ("r2", "c3"): [4.1, 6.3, 5.5, 5.4],
    ("r3", "c1"): [13.9, 16.0, 14.2, 15.2],
    ("r3", "c2"): [13.0, 13.4, 11.2, 12.8],
    ("r3", "c3"): [9.6, 9.6, 11.0, 13.4],
}

# The same, table 5 (Higgins1990Table5): tray, moisture, fertilizer, dry matter
HIGGINS_TABLE_5 = [
    ("t1", "m1", "f1", 3.3),
    ("t1", "m1", "f2", 4.3),
    ("t1", "m1", "f3", 4.5),
    ("t1", "m1", "f4", 5.8),
    ("t2", "m1", "f1", 4.0),
    ("t2", "m1", "f2", 4.1),
    ("t2", "m1", "f3", 6.5),
    ("t2", "m1", "f4", 7.3),
    ("t3", "m1", "f1", 1.9),
    ("t3", "m1", "f2", 3.8),
    ("t3", "m1", "f3", 4.4),
    ("t3", "m1", "f4", 5.1),
    ("t4", "m2", "f1", 5.0),
    ("t4", "m2", "f2", 7.9),
    ("t4", "m2", "f3", 10.7),
    ("t4", "m2", "f4", 13.5),
    ("t5", "m2", "f1", 5.9),
    ("t5", "m2", "f2", 8.5),
    ("t5", "m2", "f3", 10.3),
    ("t5", "m2", "f4", 13.9),
    ("t6", "m2", "f1", 6.9),
    ("t6", "m2", "f2", 7.0),
    ("t6", "m2", "f3", 10.9),
    ("t6", "m2", "f4", 15.2),
    ("t7", "m3", "f1", 6.5),
    ("t7", "m3", "f2", 10.7),
    ("t7", "m3", "f3", 12.2),
    ("t7", "m3", "f4", 15.7),
    ("t8", "m3", "f1", 8.2),
    ("t8", "m3", "f2", 8.9),
    ("t8", "m3", "f3", 13.4),
    ("t8", "m3", "f4", 14.9),
    ("t9", "m3", "f1", 5.2),
    ("t9", "m3", "f2", 8.6),
    ("t9", "m3", "f3", 11.1),
    ("t9", "m3", "f4", 15.6),
    ("t10", "m4", "f1", 6.8),
    ("t10", "m4", "f2", 9.0),
    ("t10", "m4", "f3", 10.3),
    ("t10", "m4", "f4", 12.5),
    ("t11", "m4", "f1", 6.4),
    ("t11", "m4", "f2", 6.0),
    ("t11", "m4", "f3", 10.7),
    ("t11", "m4", "f4", 12.5),
    ("t12", "m4", "f1", 4.0),
    ("t12", "m4", "f2", 3.8),
    ("t12", "m4", "f3", 9.4),
    ("t12", "m4", "f4", 10.2),
]


def one_factor(groups: dict[str, list[float]], *, in_blocks: bool = False) -> MeasureData:
    """Return data of one factor `A`; with blocks, the values in one place of the lists belong together."""
    rows = [
        {"A": level, VALUE: float(value), " block": f"b{place}"}
        for level, values in groups.items()
        for place, value in enumerate(values)
    ]
    return _data(rows, {"A": list(groups)}, in_blocks=in_blocks)


def two_factors(cells: dict[tuple[str, str], list[float]]) -> MeasureData:
    """Return data of two factors `A` and `B`."""
    rows = [{"A": a, "B": b, VALUE: float(value)} for (a, b), values in cells.items() for value in values]
    levels = {"A": list(dict.fromkeys(a for a, _ in cells)), "B": list(dict.fromkeys(b for _, b in cells))}
    return _data(rows, levels, in_blocks=False)


def split_plot(rows: list[tuple[str, str, str, float]]) -> MeasureData:
    """Return data of two factors `A` and `B` in blocks."""
    listed = [{" block": block, "A": a, "B": b, VALUE: value} for block, a, b, value in rows]
    levels = {"A": sorted({row["A"] for row in listed}), "B": sorted({row["B"] for row in listed})}
    return _data(listed, levels, in_blocks=True)


def npk() -> MeasureData:
    """Return the yields of peas under three fertilisers, in blocks of which each holds half of the combinations."""
    rows = [
        {" block": f"b{block}", **dict(zip("NPK", plot, strict=False)), VALUE: float(plot[4:])}
        for block, plots in enumerate(NPK, start=1)
        for plot in plots
    ]
    return _data(rows, {name: ["0", "1"] for name in "NPK"}, in_blocks=True)


def _data(rows: list[dict], levels: dict[str, list[str]], *, in_blocks: bool) -> MeasureData:
    frame = pd.DataFrame(rows)
    frame["run_id"] = [f"r_{place}" for place in range(1, len(frame) + 1)]
    frame[" place"] = range(1, len(frame) + 1)
    for name, treatments in levels.items():
        frame[name] = pd.Categorical(frame[name], treatments, ordered=True)
    return MeasureData("y", frame, frame, tuple(levels), in_blocks)

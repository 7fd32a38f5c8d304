# SPDX-License-Identifier: Apache-2.0
"""The study's figures, as SVG."""
import matplotlib

matplotlib.use("svg")
matplotlib.rcParams["svg.hashsalt"] = "clba"  # equal figures are equal files
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import methods  # noqa: E402
import scenes  # noqa: E402
import timing  # noqa: E402
from errors import similarity  # noqa: E402

SHOWN_POINTS = 6000


def save(figure, path):
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None}, dpi=130)
    plt.close(figure)


def model(num_images, observations_per_image, disturbance, path):
    """Figs. 2 and 3: the hall from above and from the side, before and after, over the truth."""
    scene = scenes.hall(num_images, observations_per_image, timing.SEED, disturbance)
    solved, _ = methods.solve(methods.ALL["default"], scene)
    truth = scene.truth.points
    shown = np.random.default_rng(0).permutation(len(truth))[:SHOWN_POINTS]
    figure, axes = plt.subplots(2, 2, figsize=(11, 6), height_ratios=[2.4, 1])
    for column, (title, problem) in enumerate((("before", scene.start), ("after", solved))):
        move = similarity(problem.centers, scene.centers)
        points, centers = move(problem.points)[shown], move(problem.centers)
        for row, (x, y) in enumerate(((0, 1), (0, 2))):
            axis = axes[row, column]
            axis.scatter(truth[shown, x], truth[shown, y], s=1.2, color="0.75", linewidths=0,
                         rasterized=True, label="true points")
            axis.scatter(points[:, x], points[:, y], s=1.2, color="C0", linewidths=0,
                         rasterized=True, label="points")
            axis.plot(scene.centers[:, x], scene.centers[:, y], color="0.4", linewidth=1,
                      label="true camera centres")
            axis.plot(centers[:, x], centers[:, y], color="C3", linewidth=0.8,
                      label="camera centres")
            low, high = truth[:, [x, y]].min(axis=0) - 1, truth[:, [x, y]].max(axis=0) + 1
            axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal",
                     xlabel="metres", ylabel=("from above" if row == 0 else "from the side"))
        axes[0, column].set_title(f"{num_images} images, {title}")
    axes[0, 0].legend(fontsize="small", markerscale=4, loc="center")
    save(figure, path)


def growth(rows, labels, fits, path):
    """Fig. 4: seconds against images."""
    figure, axis = plt.subplots(figsize=(11, 5))
    for index, (name, label) in enumerate(labels.items()):
        of = [row for row in rows if row["name"] == name]
        if not of:
            continue
        images = [row["images"] for row in of]
        seconds = [timing.median_seconds(row) for row in of]
        low, high = zip(*(timing.spread_seconds(row) for row in of))
        slope, factor, error = fits[name]
        axis.errorbar(images, seconds, color=f"C{index}", marker="o", markersize=4, linewidth=0,
                      elinewidth=1,
                      yerr=[np.subtract(seconds, low), np.subtract(high, seconds)],
                      label=f"{label}: exponent {slope:.2f} ± {error:.2f}")
        axis.plot(images, [factor * each**slope for each in images], color=f"C{index}",
                  linewidth=1)
    axis.set(xscale="log", yscale="log", xlabel="images", ylabel="seconds to the end of the solve")
    ticks = sorted({row["images"] for row in rows})
    axis.set_xticks(ticks, [str(each) for each in ticks], fontsize="x-small")
    axis.minorticks_off()
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
    save(figure, path)


def by_iteration(rows, path):
    """Position error of the paper's algorithm ended early: median over seeds, and their range."""
    figure, axis = plt.subplots(figsize=(8, 5.5))
    for index, name in enumerate(dict.fromkeys(row["method"] for row in rows)):
        of = [row for row in rows if row["method"] == name]
        iterations = sorted({row["iterations"] for row in of})
        errors = [[row["rmse"] for row in of if row["iterations"] == each] for each in iterations]
        axis.plot(iterations, [np.median(each) for each in errors], marker="o", markersize=4,
                  color=f"C{index}", label=methods.ALL[name].label)
        axis.fill_between(iterations, [min(each) for each in errors],
                          [max(each) for each in errors], color=f"C{index}", alpha=0.15)
    axis.set(yscale="log", xlabel="iterations", ylabel="RMS error of camera centres, metres")
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.12))
    save(figure, path)

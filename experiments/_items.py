"""Every script that `all.py` runs, and how."""

from typing import NamedTuple


class Item(NamedTuple):
    """A script and how it is run.

    Attributes:
        name: of its folder of results.
        script: below `experiments/`.
        quick: arguments of the quick tier; None leaves it to the full one.
        full: arguments of the full tier; `{data}` is the folder of development data.
        what: the thesis' table or figure, or what it shows.
    """

    name: str
    script: str
    quick: str | None
    full: str
    what: str


ITEMS = (
    Item(
        "figure_5_4",
        "figure_5_4.py",
        "--scenes edges --pixels 96 --sizes 12 --methods ours k-means",
        "--scenes demo edges --sizes 15 20 25 30 35 40",
        "Figures 5.4, 5.8, 5.9, A.5 to A.10: superpixels",
    ),
    Item(
        "figure_a_1",
        "figure_a_1.py",
        "--scenes edges --pixels 96 --size 12 --methods ours k-means k-means-true --factors 1 4",
        "--scenes edges",
        "Figures A.1 to A.3: weights of the clustering",
    ),
    Item(
        "figure_a_4",
        "figure_5_4.py",
        None,
        "--scenes edges --pixels 256 --strides 1 2 4 --methods ours k-means",
        "Figure A.4: fewer views, larger disparities",
    ),
    Item(
        "thesis_steps",
        "thesis_steps.py",
        "--scenes edges --size 96 --only thesis authors",
        "",
        "What each step of Chapters 4 and 6 costs, and the authors' program",
    ),
    Item(
        "table_edges",
        "table_edges.py",
        "--scenes edges --size 64",
        "",
        "What the edges are worth: presets, and parts taken away",
    ),
    Item(
        "table_6_1",
        "table_6_1.py",
        "--scenes edges --size 96",
        "--ablations",
        "Table 6.1: the centre view's depth beside baselines",
    ),
    Item(
        "peer_maps",
        "peer_maps.py",
        "--data {data}",
        "--data {data}",
        "Table 6.1: published maps of others by our metrics",
    ),
    Item(
        "table_6_2",
        "table_6_2.py",
        "--scenes edges --size 96",
        "",
        "Table 6.2: how the side of an edge is chosen",
    ),
    Item(
        "table_6_3",
        "table_6_3.py",
        "--scenes edges --size 96",
        "",
        "Table 6.3, Figure 6.4: depth boundaries",
    ),
    Item(
        "figure_6_10",
        "figure_6_10.py",
        "--scenes edges --size 64 --steps 3 --only edges.lines.aligned edges.color_sigma",
        "--scenes edges demo --size 128",
        "Figure 6.10: error against the thesis' hyperparameters",
    ),
    Item(
        "figure_6_10_full",
        "figure_6_10.py",
        None,
        "--scenes edges demo --size 128 --preset full",
        "Error against hyperparameters of preset full",
    ),
    Item(
        "every_view",
        "every_view.py",
        "edges --size 96 --views 5 --methods ours naive --repeats 1",
        "demo edges crossing thin wide room bench",
        "Figures 6.5, 6.6: depth of every view, and its consistency",
    ),
    Item(
        "every_view_lytro",
        "every_view.py",
        None,
        "{data}/lytro/2067 --views 7",
        "Figures 6.5, 6.6 of a light field without truth",
    ),
    Item(
        "figure_6_11",
        "figure_6_11.py",
        "--scenes edges --size 96 --views 5 --methods ours naive",
        "--scenes {data}/traced/room",
        "Figures 6.7, 6.11, B.10: a card put into all views",
    ),
    Item(
        "figures_b",
        "figures_b.py",
        "--scenes edges --size 64 --methods thesis naive --only B.3",
        "--scenes edges",
        "Figures B.1, B.3 to B.5, B.7: noise in labels, blur, darkness",
    ),
    Item(
        "table_7_1",
        "table_7_1.py",
        "--scenes edges --size 64 --methods sweep linear diffusion",
        "",
        "Table 7.1: depth from five posed photographs",
    ),
    Item(
        "table_7_1_dense",
        "table_7_1.py",
        "--scenes edges --size 64 --methods sweep from_sweep",
        "--scenes livingroom5 --references 1 --methods sweep optimised from_sweep",
        "Table 7.1: labels of a dense map, optimised, as Ours-C",
    ),
    Item(
        "table_7_2",
        "table_7_2.py",
        None,
        "--scenes hci/cotton hci/backgammon",
        "Table 7.2: self-supervised optimisation",
    ),
    Item(
        "chapter_7",
        "chapter_7.py",
        "--scenes edges --size 64 --iterations 3 --passes 2 --renderers narrow",
        "--scenes edges",
        "Chapter 7 as printed, Figure 7.7: points, turns, nothing thrown away",
    ),
    Item(
        "figure_7_10",
        "figure_7_10.py",
        "--scenes edges --size 96 --iterations 20",
        "--scenes hci/cotton edges",
        "Figure 7.10: supervised optimisation",
    ),
    Item(
        "codec",
        "codec.py",
        None,
        "--scenes hci/cotton demo edges --size 512",
        "Depth maps as points: rate and distortion",
    ),
    Item(
        "irregular_views",
        "irregular_views.py",
        None,
        "",
        "Rows of views at uneven positions, arrays of oblong cells",
    ),
    Item(
        "table_c_1",
        "table_c_1.py",
        "--scenes edges --size 96 --views 5 --methods ours",
        "--scenes {data}/lytro/2067",
        "Table C.1: reprojection error without truth",
    ),
    Item("figure_c_1", "figure_c_1.py", None, "--scene hci/cotton", "Figure C.1: noise on points"),
    Item("figure_c_9", "figure_c_9.py", None, "--scene hci/cotton", "Figure C.9: fewer points"),
    Item(
        "edge_accuracy",
        "edge_accuracy.py",
        "synthetic:demo --size 96",
        "cotton backgammon synthetic:demo synthetic:wide --data {data} --sweep",
        "Chapter 4: accuracy of the multi-view edges",
    ),
    Item(
        "robustness",
        "robustness.py",
        "demo --size 96 --changes clean",
        "{data}/hci/cotton {data}/traced/bench demo",
        "Noise, gain, brightness",
    ),
    Item(
        "calibration",
        "calibration.py",
        "demo --size 96",
        "--map-only",
        "Are standard errors true?",
    ),
    Item(
        "secants",
        "secants.py",
        None,
        "--preset full",
        "Do derivatives mean something?",
    ),
    Item(
        "secants_edges",
        "secants.py",
        None,
        "--preset edges",
        "Do derivatives of the edges' chain mean something?",
    ),
    Item(
        "taps_and_chance",
        "taps_and_chance.py",
        None,
        "",
        "Do learned filters do better than random ones?",
    ),
    Item(
        "learn_parameters",
        "learn_parameters.py",
        None,
        "",
        "Parameters learned by gradient",
    ),
    Item(
        "learn_taps",
        "learn_parameters.py",
        None,
        "--what taps --preset edges --learn demo --rate 0.003 --steps 20 --seeds 1",
        "Filters learned by gradient",
    ),
    Item(
        "learn_bank",
        "learn_bank.py",
        None,
        "",
        "Filters learned by gradient in the thesis' chain",
    ),
    Item(
        "learn_views",
        "learn_parameters.py",
        None,
        "--loss views --seeds 1",
        "Parameters learned by gradient from views alone",
    ),
    Item(
        "learned_smoothness",
        "learned_smoothness.py",
        None,
        "",
        "A small network that learns where smoothness ends",
    ),
    Item(
        "learned_parts",
        "learned_parts.py",
        None,
        "",
        "Numbers and networks learned from random scenes",
    ),
    Item(
        "second_order",
        "second_order.py",
        None,
        "",
        "Gauss-Newton against Adam",
    ),
    Item("hidden_points", "hidden_points.py", None, "", "Points that a neighbour hides"),
    Item(
        "solver_truth",
        "solver_truth.py",
        "--sizes 64 --seeds 1",
        "",
        "Does the solver say the truth?",
    ),
    Item(
        "benchmark_diffusion",
        "benchmarks/diffusion.py",
        "--only ours --sizes 128 --contrasts 1 1e6 --no-real",
        "",
        "Seconds of one diffusion",
    ),
    Item(
        "benchmark_large",
        "benchmarks/large.py",
        "--sizes 256 --memory 1.2",
        "--sizes 512 1024 2048",
        "Seconds and memory of large images, in tiles",
    ),
    Item(
        "benchmark_batch_machines",
        "benchmarks/batch_machines.py",
        None,
        "",
        "Many light fields on two workers, one of which is killed",
    ),
    Item(
        "benchmark_sweep",
        "benchmarks/sweep.py",
        None,
        "--size 96",
        "Settings per second: batches beside single calls",
    ),
    Item(
        "benchmark_edges",
        "benchmarks/edges.py",
        None,
        "",
        "Seconds of the points' stages, beside SciPy and OpenCV",
    ),
    Item(
        "benchmark_optimise",
        "benchmarks/optimise.py",
        None,
        "",
        "Seconds of a step of the optimisation",
    ),
    Item(
        "benchmark_depth",
        "benchmarks/depth.py",
        "--settings --repeats 1",
        "",
        "Seconds and memory of the centre view's depth",
    ),
    Item(
        "benchmark_calls",
        "benchmarks/depth.py",
        None,
        "--calls --repeats 3",
        "Seconds and memory of presets and of the gradient",
    ),
)

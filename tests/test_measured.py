"""The tables of docs/ that pieces make, and the verdicts on claims, from known numbers."""

import pytest

from piegraph_cli.evaluation.statistics import verdict
from piegraph_cli.experiments.claims import CLAIMS, Claim, Finding, findings
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import Piece, keep_pieces
from piegraph_cli.experiments.results import put_together
from tests.experiments.made_up import experiment, played, predicted
from tools import measured
from tools.measured import NAMES, OBJECTS, Measured
from tools.tables import PAGES, PLACE, filled

PARAMS = experiment(interactions={"tblock": (6,), "toy": (6,)}, models=("static", "piegraph", "pgnd", "gnn"))
PLAYS = {"models": ("piegraph", "pgnd"), "goals": 2, "seeds": 2, "strokes": 3, "thresholds": (0.05, 0.2)}


def of(params: ExperimentParams, env: str, errors: dict[str, list[float]]) -> list[Piece]:
    """Pieces of models whose sequences have these errors, the same from both seeds."""
    return [
        predicted(params, env, model if model == "static" else f"{model}@{count}", seed, pd)
        for model, pd in errors.items()
        for count in params.interactions[env][:1]
        for seed in ((0,) if model == "static" else params.seeds)
    ]


FOUND = [
    *of(PARAMS, "tblock", {"static": [9, 11], "piegraph": [2, 4], "pgnd": [3, 5], "gnn": [1, 2]}),
    *of(PARAMS, "toy", {"static": [8, 8], "piegraph": [2, 4], "pgnd": [1, 5]}),
]


@pytest.fixture
def tables(tmp_path, monkeypatch):
    """Tables of pieces, of an experiment with other settings in place of every shipped one."""

    def make(params: ExperimentParams, pieces: list[Piece]) -> Measured:
        assert keep_pieces(pieces, tmp_path) == []
        monkeypatch.setattr(measured, "load_experiment", lambda name, quick: params)
        return Measured(tmp_path)

    return make


@pytest.mark.parametrize(
    ("gain", "word"),
    [
        ((1.0, 0.1, 2.0), "better"),
        ((-1.0, -2.0, -0.1), "worse"),
        ((1.0, -0.1, 2.0), "level"),
        ((1.0, 0.0, 2.0), "level"),
    ],
)
def test_a_verdict_comes_from_the_interval(gain, word):
    assert verdict(gain) == word
    assert verdict((gain[0], float("nan"), float("nan"))) == "", "one sequence of one seed decides nothing"


def test_the_table_of_predictions_says_whether_piegraph_is_first(tables):
    table = tables(PARAMS, FOUND).table("dynamics")
    lines = table.splitlines()
    assert lines[:9] == [
        "| PD [cm], H = 4 | T-block, 6 sequences | toy, 6 sequences |",
        "|---|---|---|",
        "| `static` | 10.00 [9.00, 11.00] | 8.00 [8.00, 8.00] |",
        "| `piegraph` | 3.00 [2.00, 4.00] | 3.00 [2.00, 4.00] |",
        "| `pgnd` | 4.00 [3.00, 5.00] | 3.00 [1.00, 5.00] |",
        "| `gnn` | 1.50 [1.00, 2.00] | |",
        "| `piegraph`, H = 1 | 0.75 [0.50, 1.00] | 0.75 [0.50, 1.00] |",
        "| `static`, H = 1 | 2.50 [2.25, 2.75] | 2.00 [2.00, 2.00] |",
        "| **`piegraph` against the others** | behind `gnn` | first or level of those measured |",
    ]
    assert (
        "Measured 2026-11-27; a processor, 2 cores. piegraph 1.2.0; versions: simulate 3, dataset 4, evaluate 5"
        in table
    )
    assert table.endswith("`piegraph reproduce known`.\n\nLeft empty: toy: gnn@6: not measured.\n")
    short = tables(PARAMS, FOUND).table("dynamics-four-strokes").splitlines()
    assert [line.split("|")[1].strip() for line in short[2:7]] == [
        "`piegraph`", "`pgnd`", "`static`", "`piegraph`, H = 1", "`static`, H = 1",
    ]  # fmt: skip


def test_commands_below_a_table_do_not_say_whose_rows_each_piece_was_made_with(tables):
    told = [
        f"piegraph reproduce known{more}"
        for more in (
            "",
            """ --set 'models=["static","gnn"]'""",
            """ --set seeds=[0] --set 'trials.models=["gnn"]' --set 'models=["gnn"]' --set trials.goals=2""",
        )
    ]
    pieces = [piece.model_copy(update={"command": told[i % 3]}) for i, piece in enumerate(FOUND)]
    text = tables(PARAMS, pieces).table("dynamics")
    assert "`piegraph reproduce known`. `piegraph reproduce known --set seeds=[0] --set trials.goals=2`.\n" in text


CLAIM = Claim("x", "nearer than PGND and a plain network", "dynamics", ("pgnd", "gnn"))


def test_a_claim_is_judged_on_every_object_against_every_rival():
    found = findings(CLAIM, PARAMS, put_together("known", PARAMS, FOUND))
    assert [(f.environment, f.rival, f.gain and f.gain[0], f.verdict) for f in found] == [
        ("tblock", "pgnd", pytest.approx(1.0), "better"),
        ("tblock", "gnn", pytest.approx(-1.5), "worse"),
        ("toy", "pgnd", pytest.approx(0.0), "level"),
        ("toy", "gnn", None, ""),
    ]


def test_claims_are_written_with_their_verdicts(tables, monkeypatch):
    other = Claim("y", "guided is nearer", "dynamics", ("piegraph-ng",))
    monkeypatch.setattr(measured, "CLAIMS", (CLAIM, other))
    made = tables(PARAMS, FOUND)
    assert made.table("claims").splitlines()[2:] == [
        f"| {CLAIM.text} | better: `pgnd`; worse: `gnn` | | | | level: `pgnd`; not measured: `gnn` | |",
        f"| {other.text} | not measured | | | | not measured | |",
    ]
    assert made.table("claim-x").splitlines()[:6] == [
        "| piegraph's gain on | T-block | toy |",
        "|---|---|---|",
        "| `pgnd`, PD | +1.00 [+1.00, +1.00] better | +0.00 [-1.00, +1.00] level |",
        "| `gnn`, PD | -1.50 [-2.00, -1.00] worse | not measured |",
        "",
        "Verdict: better: `pgnd`; worse: `gnn` on T-block; level: `pgnd`; not measured: `gnn` on toy.",
    ]
    assert made.table("claim-y") is None


def test_measures_that_differ_are_named():
    found = [Finding("toy", "gnn", "pd", (0.0, -1.0, 1.0)), Finding("toy", "gnn", "cd+s", (1.0, 0.5, 2.0))]
    assert measured._word(found) == "better: CD+S; level: PD"


def test_planning_has_cliffs_delta_and_its_verdict(tables, monkeypatch):
    params = experiment(trials=PLAYS)
    ours = played(params, "planning", "tblock", "piegraph@6", [[0.01, 0.02], [0.03, 0.04]])
    rival = played(params, "planning", "tblock", "pgnd@6", [[0.06, 0.1], [0.2, 0.5]])
    made = tables(params, [ours, rival])
    assert made.table("planning").splitlines()[:4] == [
        "| | trials | final PD [cm] | below 5 cm | below 20 cm | strokes to 5 cm, median | "
        "δ of the final PD, `piegraph` over it | verdict |",
        "|---|---|---|---|---|---|---|---|",
        "| T-block, `piegraph` | 4 | 2.50 [1.50, 3.50] | 100 % | 100 % | 1 | | |",
        "| T-block, `pgnd` | 4 | 21.50 [8.00, 40.00] | 0 % | 50 % | over 3 | +1.00 [+1.00, +1.00] | better |",
    ]
    claim = Claim("z", "plans better", "planning", ("pgnd",), metrics=("final PD",))
    monkeypatch.setattr(measured, "CLAIMS", (claim,))
    assert "| `pgnd`, δ of the final PD | +1.00 [+1.00, +1.00] better |" in made.table("claim-z")
    trials = played(params, "ablations", "tblock", "piegraph@6", [[0.01, 0.03]] * 2)
    ablated = [*of(params, "tblock", {"piegraph": [2, 4]}), trials]
    assert "| `piegraph` | 0.75 / 3.00; 2.00, 50 % |" in tables(params, ablated).table("ablations")


def test_data_fidelity_and_table_1_and_the_search(tables):
    params = experiment("interactions", interactions={"toy": (6, 12)}, models=("piegraph",))
    pieces = [
        predicted(params, "toy", f"piegraph@{n}", seed, [pd, pd + 1])
        for n, pd in ((6, 3.5), (12, 1.5))
        for seed in (0, 1)
    ]
    assert tables(params, pieces).table("data-fidelity").splitlines()[:4] == [
        "| PD [cm] of `piegraph` | 6 sequences | 12 sequences |",
        "|---|---|---|",
        "| toy, H = 1 | 1.00 [0.88, 1.12] (+100 %) | 0.50 [0.38, 0.62] |",
        "| toy, H = 4 | 4.00 [3.50, 4.50] (+100 %) | 2.00 [1.50, 2.50] |",
    ]
    guided = experiment("guidance", models=("piegraph-ng", "piegraph"), paper={"tblock": {"4": (4.0, 2.0)}})
    pieces = of(guided, "tblock", {"piegraph-ng": [3, 3], "piegraph": [1, 2]})
    assert tables(guided, pieces).table("table1").splitlines()[2:3] == [
        "| T-block | 4 | (330.00, 165.00) | (4.0, 2.0) | 2.00 | 2.00 |"
    ]
    search = experiment("search", models=("pgnd",), seeds=(0,))
    assert "| `pgnd` | **0.1** |" in tables(search, of(search, "tblock", {"pgnd": [3, 3]})).table("search")


def test_the_table_of_budgets(tables):
    lines = tables(PARAMS, FOUND).table("budget").splitlines()
    assert lines[0].startswith("| candidates searched; steps; minutes of one core; numbers learned | T-block")
    assert lines[2:5] == [
        "| `piegraph` | –; 2,600; 0.5; 26,884 | –; 2,600; 0.5; 26,884 |",
        "| `pgnd` | –; 2,600; 0.5; 26,884 | –; 2,600; 0.5; 26,884 |",
        "| `gnn` | –; 2,600; 0.5; 26,884 | |",
    ]


def test_what_is_not_measured_keeps_its_file_or_says_so(tmp_path):
    page = "<!-- table: claim-pgnd -->\n<!-- end -->\n"
    assert filled(page, tmp_path) == f"<!-- table: claim-pgnd -->\n{measured.NOT_MEASURED}\n<!-- end -->\n"
    (tmp_path / "claim-pgnd.toml").write_text('title = "t"\ncolumns = [{ name = "a" }]\nrows = [["b"]]')
    assert "| b |" in filled(page, tmp_path)


def test_every_claim_has_its_place_on_the_page():
    page = next(path for path in PAGES if path.name == "claims.md").read_text(encoding="utf-8")
    shown = [name for _, name, _, _ in PLACE.findall(page)]
    assert shown == ["claims", *(f"claim-{claim.name}" for claim in CLAIMS)]
    assert set(shown) <= set(NAMES)
    for claim in CLAIMS:
        params = measured.load_experiment(claim.experiment, quick=False)
        assert set(params.interactions) <= set(OBJECTS)
        known = {
            m.partition("@")[0] for m in (params.trials.models if claim.metrics == ("final PD",) else params.models)
        }
        assert {m.partition("@")[0] for m in (claim.ours, *claim.rivals)} <= known, "a claim about what is not measured"

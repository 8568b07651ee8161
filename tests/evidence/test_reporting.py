"""Records and exit status of evidence commands."""

from deltasafe.io.storage import read_json
from evidence.reporting import command_parser, finish


def options_of(record, *arguments):
    parser = command_parser("faults.example", "An example.", seeded=True)
    parser.add_argument("--count", type=int, default=5)
    parser.add_argument("--alone", action="store_true")
    return parser.parse_args(["--record", str(record), *arguments])


def test_record_stores_command_line_with_defaults_and_null_for_nan(tmp_path):
    record = tmp_path / "record.json"
    assert finish(options_of(record), {"made": 2.0}, rates={"a": [1.0, float("nan")]}) == 0
    part = read_json(record)["parts"]["example"]
    assert part["command"] == "python -m evidence.faults.example --seed 0 --count 5"
    assert part["seeds"] == {"seed": 0}
    assert part["rates"] == {"a": [1.0, None]}
    finish(options_of(record, "--alone", "--seed", "3"), {"made": 2.0})
    assert read_json(record)["command"] == "python -m evidence.faults.example --seed 3 --count 5 --alone"


def test_failures_are_printed_and_give_status_1(tmp_path, capsys):
    options = command_parser("faults.example", "An example.").parse_args([])
    assert finish(options, {"lost": 1}, ["case 7 is lost"]) == 1
    printed = capsys.readouterr()
    assert "lost: 1" in printed.out
    assert "FAILED  case 7 is lost" in printed.err

"""Test data of projects that the fit has seen."""

import pytest

from kennfeld import cli

TEST = '\n[[dataset]]\nfiles = ["{}"]\nuse = "test"\n'
REMEDY = "Hold out other data: the error on these does not show how the function works on unseen data."


def with_test(shop, name="fresh.csv", further=""):
    return shop.change("[calibration]", TEST.format(name) + further + "\n[calibration]")


def warnings_on(shop):
    assert shop.errors() == []
    return [str(finding) for finding in shop.findings() if REMEDY in str(finding)]


def other(shop, name="fresh.csv"):
    shop.bench(name, speed=(1100, 1600, 2100, 2600, 2900, 1300))


def test_other_data_are_unseen(shop):
    other(shop)
    assert warnings_on(with_test(shop)) == []


def test_the_same_file_is_a_warning(shop):
    message = "the test file bench.csv is also a training file"
    messages = warnings_on(with_test(shop, "bench.csv", 'name = "again"\n'))
    assert messages == [f"kennfeld.toml [[dataset]] 2: {message}. {REMEDY}"]


def test_a_copy_of_a_file_is_a_warning(shop):
    shop.write("copy.csv", (shop.folder / "bench.csv").read_bytes())
    message = "the test file copy.csv has the same content as the training file bench.csv"
    assert warnings_on(with_test(shop, "copy.csv")) == [f"kennfeld.toml [[dataset]] 2: {message}. {REMEDY}"]


def test_equal_samples_of_another_file_are_a_warning(shop):
    shop.bench("fresh.csv", speed=(1000, 1500, 2000, 2600, 2900, 1300))
    message = "3 of 6 test samples have the same inputs and targets as samples of bench"
    assert warnings_on(with_test(shop)) == [f"kennfeld.toml [[dataset]] 2 (fresh): {message}. {REMEDY}"]


def test_a_file_may_be_divided_by_conditions(shop):
    shop.change('files = ["bench.csv"]', 'files = ["bench.csv"]\nwhere = "n < 2200"')
    with_test(shop, "bench.csv", 'name = "high"\nwhere = "n > 2200"\n')
    assert warnings_on(shop) == []
    shop.change("n > 2200", "n > 1300")
    message = "2 of 4 test samples have the same inputs and targets as samples of bench"
    assert warnings_on(shop) == [f"kennfeld.toml [[dataset]] 2: {message}. {REMEDY}"]


def test_a_different_file_of_the_same_size_is_unseen(shop):
    other(shop)
    text = (shop.folder / "fresh.csv").read_text()
    shop.write("bench.csv", text.replace("1100", "1200"))
    assert [finding for finding in warnings_on(with_test(shop)) if "same content" in finding] == []


def test_check_and_calibrate_warn_of_seen_data(shop, capsys):
    shop.write("copy.csv", (shop.folder / "bench.csv").read_bytes())
    path = with_test(shop, "copy.csv").path
    for command in ("check", "calibrate"):
        assert cli.run([command, str(path)]) == 0
        assert "warning" in (message := capsys.readouterr().err)
        assert "has the same content as the training file bench.csv" in message


@pytest.mark.parametrize("weight", [0, 1])
def test_data_of_weight_zero_do_not_count_as_seen(shop, weight):
    other(shop)
    shop.change('["bench.csv"]', f'["bench.csv"]\nweight = {weight}\n[[dataset]]\nfiles = ["fresh.csv"]')
    assert len(warnings_on(with_test(shop, "bench.csv", 'name = "again"\n'))) == weight

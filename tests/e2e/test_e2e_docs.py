"""The documents are true: their commands run, and print what they are said to."""
import docs_commands
from farm import ROOT


def test_readme():
    assert docs_commands.check(ROOT / "README.md", "Five minutes") == []


def test_tutorial():
    assert docs_commands.check(ROOT / "docs/TUTORIAL.md") == []


def test_it_can_fail(tmp_path):
    """A wrong hash, a command that fails and a line that is not printed are found."""
    text = """    $ tilery help settings
    nobody prints this
    $ tilery render scenes/veach.json -o a.exr --spp 1 --size 8x8
      sha256   00
      time     load 7.01, build 7.00, render 7.16, gather 7.01 s; 7.3 core-s
    $ tilery status j1
"""
    (tmp_path / "a.md").write_text(text)
    found = docs_commands.check(tmp_path / "a.md")
    assert len(found) == 3
    assert "nobody prints this" in found[0] and "sha256" in found[1] and "status 4" in found[2]
    found = docs_commands.check(tmp_path / "a.md", renew=True)
    assert len(found) == 2 and "sha256   00" not in (tmp_path / "a.md").read_text()

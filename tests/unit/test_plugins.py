import subprocess
import sys
import textwrap
from functools import cache

import pytest

from testbed import plugins


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(plugins.UnknownPlugin, match=r"no sensor named 'rfdi', did you mean rfid\?"):
        plugins.load("sensors", "rfdi")


def test_a_name_near_to_nothing_is_answered_with_all_there_are():
    with pytest.raises(plugins.UnknownPlugin, match=r"there are .*compass.*odometry.*rfid"):
        plugins.load("sensors", "qqqqqq")


def test_shared_pieces_are_not_plugins():
    names = plugins.names("sensors")
    assert "rfid" in names
    assert not {"placement", "carrier", "rfid_section", "__init__"} & set(names)


def test_listing_imports_no_plugin():
    code = """
        import sys
        from testbed import plugins
        found = {g: plugins.names(g) for g in plugins.GROUPS}
        assert all(found.values()), found
        loaded = [m for g in found for n in found[g] if (m := plugins.origin(g, n).partition(":")[0]) in sys.modules]
        assert not loaded, loaded
        assert "pybullet" not in sys.modules
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=True, cwd="/")


def test_a_plugin_outside_is_found_by_its_entry_point(monkeypatch):
    entry = plugins.EntryPoint("decoder", "json:JSONDecoder", "testbed.sensors")
    monkeypatch.setattr(plugins, "_outside", cache(lambda group: {"decoder": entry} if group == "sensors" else {}))
    plugins.load.cache_clear()
    assert "decoder" in plugins.names("sensors")
    with pytest.raises(plugins.BrokenPlugin, match=r"decoder.*json:JSONDecoder.*not a class with a Config"):
        plugins.load("sensors", "decoder")
    plugins.forget()


def test_a_plugin_that_cannot_be_imported_says_where_it_is_and_why(monkeypatch):
    entry = plugins.EntryPoint("gone", "no_such_module_here:Gone", "testbed.sensors")
    monkeypatch.setattr(plugins, "_outside", cache(lambda group: {"gone": entry}))
    plugins.load.cache_clear()
    with pytest.raises(plugins.BrokenPlugin, match=r"no_such_module_here:Gone.*can't be imported"):
        plugins.load("sensors", "gone")
    plugins.forget()

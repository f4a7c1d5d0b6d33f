"""The schema that the steps make is the one that the code uses, in both databases; partitions come with their months."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from monitor.errors import StoreError
from monitor.plant.backup import forget
from monitor.plant.database import Database, DatabaseUnavailable, DataRefused
from monitor.plant.ingest import enter, keep_last_values, known, set_arms
from monitor.plant.tables import arm, friction, last_value, metadata
from monitor.reason import reason_of


def test_the_steps_make_the_tables_that_the_code_uses(database):
    """Alembic finds no difference, and a second migration does nothing."""
    database.migrate()

    def ours(_object, name, kind, _reflected, _compared):
        return not (kind == "table" and (name == "alembic_version" or name.endswith("_other")))

    with database.read() as connection:
        context = MigrationContext.configure(connection, opts={"include_object": ours, "compare_type": True})
        assert [difference for difference in compare_metadata(context, metadata) if "index" not in difference[0]] == []


def test_another_programs_database_and_a_newer_one_are_refused(address):
    """Nothing is changed in them."""
    database = Database(address)
    with database.write() as connection:
        connection.execute(sa.text("CREATE TABLE customers (id INTEGER)"))
    with pytest.raises(StoreError, match="another program's tables"):
        database.migrate()
    with database.write() as connection:
        connection.execute(sa.text("DROP TABLE customers"))
    database.migrate()
    with database.write() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(StoreError, match="another version of joint-monitor"):
        database.migrate()
    database.close()


def test_defaults_of_a_server_change_neither_times_nor_figures(postgres):
    """Of its country, its time zone, and how exactly it writes figures; with what it calls a transaction no page waits for another one."""
    strange = {"datestyle": "German", "timezone": "Asia/Kathmandu", "extra_float_digits": "-5", "intervalstyle": "iso_8601"}
    database = Database(postgres.address(**strange, default_transaction_isolation="serializable"))
    database.migrate()
    at_unix_s, figure = 1_767_571_200.123457, 0.1 + 0.2
    number = known(database, "hall", "cell-1", at_unix_s).arm
    keep_last_values(database, {(number, "health"): (at_unix_s, {"figure": figure, "text": "größer → 較大"})})
    with database.read() as connection:
        [found] = connection.execute(sa.select(last_value.c.heard_at, last_value.c.document)).all()
        third = connection.execute(sa.text("SELECT 1::float8 / 3")).scalar_one()
        isolation = connection.execute(sa.text("SHOW default_transaction_isolation")).scalar_one()
    database.close()
    assert found == (pytest.approx(at_unix_s, abs=2e-6), {"figure": figure, "text": "größer → 較大"})
    assert (third, isolation) == (1.0 / 3.0, "read committed")


@pytest.mark.parametrize("encoding", ["LATIN1", "SQL_ASCII"])
def test_a_database_that_cannot_hold_every_text_is_refused_before_anything_is_made(postgres, encoding):
    database = Database(postgres.address(f"ENCODING '{encoding}' TEMPLATE template0"))
    with pytest.raises(StoreError, match=f"has the encoding {encoding}; expected UTF8: createdb"):
        database.migrate()
    with database.read() as connection:
        assert sa.inspect(connection).get_table_names() == []
    database.close()


def test_every_month_has_a_partition_of_its_own(postgres):
    """Times of broken clocks share one, and nothing is refused."""
    database = Database(postgres.address())
    database.migrate()
    database.make_partitions("friction", [1_767_571_200.0, 1_767_571_201.0, 1_770_000_000.0, 0.0])
    database.make_partitions("friction", [1_767_571_200.0])
    with database.read() as connection:
        names = connection.execute(sa.text("SELECT relname FROM pg_class WHERE relname LIKE 'friction_%' AND relkind = 'r' ORDER BY 1"))
        assert names.scalars().all() == ["friction_2026_01", "friction_2026_02", "friction_other"]
    with database.read() as reader:  # a long query: the month ahead is made when it is over, and nobody waits for it meanwhile
        reader.execute(sa.text("SELECT count(*) FROM friction")).scalar_one()
        database.make_partitions_ahead(1_775_000_000.0)  # a moment in March 2026
        with pytest.raises(DataRefused, match="somebody reads friction for more than 1 s"):
            database.make_partitions("friction", [1_000.0 * 1_600_000.0], patience_s=1)
    database.make_partitions_ahead(1_774_000_000.0)
    with database.read() as connection:
        names = connection.execute(sa.text("SELECT relname FROM pg_class WHERE relname LIKE '%2026_04' AND relkind = 'r' ORDER BY 1"))
        assert names.scalars().all() == ["friction_2026_04", "transition_2026_04"]
    database.close()


def test_months_that_hold_nothing_any_more_go_and_come_back(postgres):
    """After an arm is forgotten; rows that come meanwhile, from a plant that has not noticed, find their month when it is made again."""
    address = postgres.address()
    plant, command = Database(address), Database(address)
    plant.migrate()
    number = known(plant, "lab", "cell-1", 1.0).arm
    january = 1_767_571_200.0
    plant.make_partitions("friction", [january, january + 31.0 * 86_400.0])
    row = {"arm": number, "history": 1, "joint": 1, "replay": 1}

    def put(replay, at):
        with plant.write() as connection:
            connection.execute(sa.insert(friction), [row | {"replay": replay, "recorded_at": at}])

    def lies():
        with plant.read() as connection:
            return connection.execute(sa.text("SELECT tableoid::regclass::text FROM friction ORDER BY recorded_at")).scalars().all()

    put(1, january + 31.0 * 86_400.0)
    command.drop_empty_partitions()
    put(2, january)
    assert lies() == ["friction_other", "friction_2026_02"]
    forget(command, "lab/cell-1", who="ada")
    with plant.read() as connection:
        assert connection.execute(sa.text("SELECT count(*) FROM pg_class WHERE relname ~ '^friction_[0-9_]+$'")).scalar_one() == 0
    put(3, january)
    plant.make_partitions_ahead(january)  # as with every heartbeat
    assert lies() == ["friction_2026_01"]
    with command.read() as reader:  # whoever reads is not held up, and holds nobody up
        reader.execute(sa.text("SELECT count(*) FROM friction")).scalar_one()
        command.drop_empty_partitions()
    assert lies() == ["friction_2026_01"]
    plant.close()
    command.close()


def test_a_server_that_does_not_get_on_is_waited_for(postgres):
    """Somebody holds a lock, or the server only reads: the plant hears it in a sentence, and goes on afterwards."""
    address = postgres.address()
    hasty, plant, admin = Database(address, patience_s=1), Database(address), Database(address)
    plant.migrate()
    with admin.write() as connection:
        connection.execute(sa.text("LOCK TABLE arm IN ACCESS EXCLUSIVE MODE"))
        with pytest.raises(DatabaseUnavailable, match="statement timeout"):
            known(hasty, "lab", "cell-1", 1.0)
    with admin.write() as connection:
        connection.execute(sa.text(f"ALTER DATABASE {plant.name.rpartition('/')[2]} SET default_transaction_read_only = on"))
    plant.forget()
    with pytest.raises(DatabaseUnavailable, match="read-only"):
        known(plant, "lab", "cell-1", 1.0)
    for each in (hasty, plant, admin):
        each.close()


def test_a_silence_keeps_its_beginning_until_it_ends(database):
    """And last values replace each other."""
    number = known(database, "lab", "cell-1", 1.0).arm
    for since, why in ((10.0, reason_of("gone")), (20.0, reason_of("still gone"))):
        set_arms(database, [{"number": number, "since": since, "why": why, "problem": None}])
    keep_last_values(database, {(number, "health"): (1.0, {"a": 1})})
    keep_last_values(database, {(number, "health"): (2.0, {"a": 2})})
    with database.read() as connection:
        assert connection.execute(sa.select(arm.c.silent_since, arm.c.silent_why)).one() == (10.0, reason_of("still gone"))
        assert connection.execute(sa.select(last_value.c.heard_at, last_value.c.document)).all() == [(2.0, {"a": 2})]
    set_arms(database, [{"number": number, "since": None, "why": None, "problem": reason_of("too old")}])
    with database.read() as connection:
        assert connection.execute(sa.select(arm.c.silent_since, arm.c.problem)).one() == (None, reason_of("too old"))


def test_arms_that_several_threads_enter_at_once_are_entered_once(database):
    """A dropped database that is back: the main loop enters all arms while threads that copy enter theirs. The plant ended."""
    names = [("hall", f"cell-{n}") for n in range(100)]
    with ThreadPoolExecutor(5) as threads:
        whole = threads.submit(enter, database, names, 0.0)
        each = list(threads.map(partial(known, database, "hall", now_unix_s=0.0), [robot for _, robot in reversed(names)]))
    assert [row.arm for row in reversed(each)] == [whole.result()[name] for name in names]
    with database.read() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(arm)).scalar_one() == 100


def test_many_arms_are_entered_in_few_ways_to_the_server(database):
    """A thousand of them, on a server far away or on a busy machine, would wait for each statement of each arm."""
    statements = []
    sa.event.listen(database._engine, "before_cursor_execute", lambda *about: statements.append(about[2]))
    names = [(f"site-{k % 3}", f"arm-{k}") for k in range(300)]
    numbers = enter(database, names[:200], 0.0)
    again = enter(database, names, 1.0)
    assert again | numbers == again
    assert len(set(again.values())) == 300
    assert len(statements) <= 12
    assert {known(database, *name, 2.0).arm for name in names} == set(again.values())

import logging
import threading

import pytest

from kennfeld.base.quiet_loggers import quiet_loggers


@pytest.mark.parametrize("name", ["somebody", "somebody.inside"])
def test_a_library_is_quiet_in_the_thread_of_the_call_only(name, caplog):
    logger = logging.getLogger(name)
    before = logger.level, logger.disabled
    with quiet_loggers("somebody"):
        logger.error("dropped")
        other = threading.Thread(target=logger.error, args=("of another thread",))
        other.start()
        other.join()
        logging.getLogger("somebodyelse").error("of another library")
    logger.error("afterwards")
    assert caplog.messages == ["of another thread", "of another library", "afterwards"]
    assert (logger.level, logger.disabled) == before

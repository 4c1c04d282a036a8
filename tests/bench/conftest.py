from ..slam.conftest import rendered

__all__ = ["rendered"]

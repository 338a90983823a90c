"""From a scene to a picture: ``api.render``; the backends ``cpu`` and ``gpu``; ``lines`` and ``furniture`` of both."""

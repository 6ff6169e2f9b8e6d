"""Does the driver keep what it promises, on the card of card.yaml? The motor may twitch: docs/plug-in-driver.md."""

import rig.testing.conformance

TestCard = rig.testing.conformance.suite("card.yaml")

"""The bench's instruments from the other side: emulators on real transports, fed by a plant."""

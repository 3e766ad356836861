"""The component's side of a hand-over: agreed cuts, batons, and the state that moves with them."""

PUBLIC = "BatonState BatonStep BatonWord HandoverCommands"

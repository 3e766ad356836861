"""The JSON forms of what the model has, and their one codec: reading, writing and JSON Schema.

`form` (the base classes), `reading` (with `fault_finder`: every fault at its path), `contract`, `parameter`,
`component`, `specification`, `configuration` (the forms), `schema`. The forms of plans are in :mod:`midstride.plan`,
those of what the manager reports in :mod:`midstride.runtime`; they are made of the same base classes.
"""

PUBLIC = (
    "CONNECTOR_FORMS ComponentForm ConfigurationForm Document FiniteNumber Form FormCheck InstanceForm "
    "NamedComponentForm NodeForm NonEmptyName Report Schema SecondsOrZero SectionForm SectionsForm "
    "SharedContainerForm SpecificationForm ValueForm decode decode_component decode_saved_specification "
    "decode_specification encode encode_component encode_specification expressible field from_json given json_value "
    "json_values of_kind parse_json schemas specification_schema strict_json to_json under value_of values_form "
    "values_of"
)

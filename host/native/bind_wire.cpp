// tautline._native.wire: the messages of tl_wire.h as Python sees them, built from the same field lists.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <cstring>
#include <string>

#include "tautline/tl_wire.h"

namespace nb = nanobind;

namespace {

template <typename T> nb::object to_python(const T &value) {
    return nb::int_(value);
}

template <typename T, size_t N> nb::object to_python(const T (&values)[N]) {
    if constexpr (std::is_same_v<T, char>) {
        const auto size = static_cast<Py_ssize_t>(strnlen(values, N));
        return nb::steal(PyUnicode_DecodeUTF8(values, size, "replace")); // any bytes may come
    } else {
        nb::list list;
        for (const T &value : values) {
            list.append(nb::int_(value));
        }
        return nb::tuple(list);
    }
}

[[noreturn]] void refuse(const char *field, const std::string &what) {
    throw nb::value_error((std::string(field) + ": " + what).c_str());
}

template <typename T> void from_python(const char *field, nb::handle value, T &out) {
    if (!nb::try_cast(value, out, false)) {
        refuse(field, "expected an integer of " + std::to_string(8 * sizeof(T)) + " bits");
    }
}

template <typename T, size_t N> void from_python(const char *field, nb::handle value, T (&out)[N]) {
    if constexpr (std::is_same_v<T, char>) {
        std::string text;
        if (!nb::try_cast(value, text, false)) {
            refuse(field, "expected text");
        }
        if (text.size() > N) {
            refuse(field, "longer than " + std::to_string(N) + " bytes");
        }
        std::memcpy(out, text.data(), text.size());
    } else {
        if (!nb::isinstance<nb::sequence>(value) || nb::len(value) != N) {
            refuse(field, "expected " + std::to_string(N) + " values");
        }
        for (size_t i = 0; i < N; i++) {
            from_python(field, value[i], out[i]);
        }
    }
}

nb::dict decode(uint8_t type, const tl_wire_message_t &message) {
    nb::dict fields;
    switch (type) {
#define FIELD(kind, name, doc)        fields[#name] = to_python(from.name);
#define ARRAY(kind, name, count, doc) fields[#name] = to_python(from.name);
#define CASE(code, NAME, name, doc)                                                                                    \
    case code: {                                                                                                       \
        const tl_wire_##name##_t &from = message.name;                                                                 \
        TL_WIRE_FIELDS_##NAME(FIELD, ARRAY) break;                                                                     \
    }
        TL_WIRE_MESSAGES(CASE)
#undef FIELD
#undef ARRAY
#undef CASE
    default:
        break;
    }
    return fields;
}

const char *name_of(uint8_t type) {
    switch (type) {
#define CASE(code, NAME, name, doc)                                                                                    \
    case code:                                                                                                         \
        return #name;
        TL_WIRE_MESSAGES(CASE)
#undef CASE
    default:
        return nullptr;
    }
}

nb::bytes encode(const std::string &wanted, uint16_t sequence, const nb::dict &fields) {
    tl_wire_message_t message{};
    uint8_t type = 0;
    size_t known = 0;
    const auto take = [&](const char *field, auto &out) {
        if (!fields.contains(field)) {
            refuse(field, "missing");
        }
        from_python(field, fields[field], out);
        known++;
    };
#define FIELD(kind, name, doc)        take(#name, to.name);
#define ARRAY(kind, name, count, doc) take(#name, to.name);
#define CASE(code, NAME, name, doc)                                                                                    \
    if (wanted == #name) {                                                                                             \
        type = code;                                                                                                   \
        [[maybe_unused]] auto &to = message.name;                                                                      \
        TL_WIRE_FIELDS_##NAME(FIELD, ARRAY)                                                                            \
    }
    TL_WIRE_MESSAGES(CASE)
#undef FIELD
#undef ARRAY
#undef CASE
    if (type == 0) {
        refuse("message", "'" + wanted + "' is not one of tl_wire.h");
    }
    if (known != nb::len(fields)) {
        refuse(wanted.c_str(), "has no such field as one of those given");
    }
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const size_t size = tl_wire_frame(frame, type, sequence, &message);
    return nb::bytes(reinterpret_cast<const char *>(frame), size);
}

class Parser {
  public:
    // Every whole frame so far: (name or None, type, sequence, fields); fields are None where the payload is unknown or
    // short.
    nb::list feed(const nb::bytes &bytes) {
        nb::list frames;
        const auto *data = reinterpret_cast<const uint8_t *>(bytes.c_str());
        size_t size = bytes.size();
        tl_wire_frame_t frame;
        while (tl_wire_parse(&parser_, &data, &size, &frame)) {
            tl_wire_message_t message{};
            nb::object fields = nb::none();
            if (tl_wire_decode(frame.type, frame.payload, frame.size, &message)) {
                fields = decode(frame.type, message);
            }
            const char *name = name_of(frame.type);
            frames.append(nb::make_tuple(name ? nb::object(nb::str(name)) : nb::object(nb::none()), frame.type,
                                         frame.sequence, fields));
        }
        return frames;
    }
    uint32_t bytes_bad() const { return parser_.bytes_bad; }

  private:
    tl_wire_parser_t parser_{};
};

} // namespace

void bind_wire(nb::module_ &m) {
    nb::module_ wire = m.def_submodule("wire", "The messages between host and board (tl_wire.h)");
    wire.attr("MAJOR") = TL_WIRE_MAJOR;
    wire.attr("MINOR") = TL_WIRE_MINOR;
    wire.attr("USB_VENDOR") = TL_WIRE_USB_VENDOR;
    wire.attr("USB_PRODUCT") = TL_WIRE_USB_PRODUCT;
    wire.attr("USB_MANUFACTURER") = TL_WIRE_USB_MANUFACTURER;
    wire.attr("USB_PACKET") = TL_WIRE_USB_PACKET;
    wire.attr("SERIAL_BAUD") = TL_WIRE_SERIAL_BAUD;
    wire.attr("PART") = TL_WIRE_PART;
    wire.attr("FRAME_MAX") = TL_WIRE_FRAME_MAX;
    wire.attr("AXES_MAX") = TL_WIRE_AXES_MAX;
    wire.attr("ALL_AXES") = TL_WIRE_ALL_AXES;
    wire.attr("BATCH_SAMPLES") = TL_WIRE_BATCH_SAMPLES;
    wire.attr("KEY") = TL_WIRE_KEY;
    wire.attr("GAIN_MAX") = TL_WIRE_GAIN_MAX;
    wire.attr("IMAGE_SIGNED") = static_cast<unsigned>(TL_WIRE_IMAGE_SIGNED);

    // MESSAGES: name -> {"type", "size", "doc", "fields": ((name, kind, count, doc), ...)}
    nb::dict messages;
    nb::list fields;
#define FIELD(kind, name, doc)        fields.append(nb::make_tuple(#name, #kind, 1, doc));
#define ARRAY(kind, name, count, doc) fields.append(nb::make_tuple(#name, #kind, count, doc));
#define MESSAGE(code, NAME, name, doc)                                                                                 \
    {                                                                                                                  \
        fields = nb::list();                                                                                           \
        TL_WIRE_FIELDS_##NAME(FIELD, ARRAY) nb::dict entry;                                                            \
        entry["type"] = code;                                                                                          \
        entry["size"] = static_cast<unsigned>(TL_WIRE_SIZE_##NAME);                                                    \
        entry["doc"] = doc;                                                                                            \
        entry["fields"] = nb::tuple(fields);                                                                           \
        messages[#name] = entry;                                                                                       \
    }
    TL_WIRE_MESSAGES(MESSAGE)
    wire.attr("MESSAGES") = messages;

    // SINCE: name -> the minor version that added it
    nb::dict since;
#define ADDED(name, minor) since[#name] = minor;
    TL_WIRE_SINCE(ADDED)
#undef ADDED
    wire.attr("SINCE") = since;

    // Each code list: NAME -> (code, text)
    nb::dict codes;
#define CODE(code, NAME, text) codes[#NAME] = nb::make_tuple(code, text);
#define LIST(attribute, list)                                                                                          \
    codes = nb::dict();                                                                                                \
    list(CODE) wire.attr(attribute) = codes;
    LIST("REASONS", TL_WIRE_REASONS)
    LIST("FAULTS", TL_WIRE_FAULTS)
    LIST("MODES", TL_WIRE_MODES)
    LIST("TABLES", TL_WIRE_TABLES)
    LIST("FLAGS", TL_WIRE_FLAGS)
    LIST("MOTIONS", TL_WIRE_MOTIONS)
    LIST("EVENTS", TL_WIRE_EVENTS)
    LIST("BOOTS", TL_WIRE_BOOTS)
    LIST("STORES", TL_WIRE_STORES)
    LIST("ESTOPS", TL_WIRE_ESTOPS)
    LIST("FIRMWARES", TL_WIRE_FIRMWARES)
    LIST("UPDATES", TL_WIRE_UPDATES)

    wire.def("encode", &encode, nb::arg("name"), nb::arg("sequence"), nb::arg("fields"),
             "The whole frame of a message; every field must be given. ValueError names the field that does not fit.");
    nb::class_<Parser>(wire, "Parser", "Finds frames in a stream of bytes, over garbage.")
        .def(nb::init<>())
        .def("feed", &Parser::feed, nb::arg("data"),
             "Takes bytes, returns [(name | None, type, sequence, fields | None), ...]: the frames that became whole.")
        .def_prop_ro("bytes_bad", &Parser::bytes_bad, "bytes so far that belonged to no whole frame");
}

#include "fields.hpp"

namespace alula::fields {

std::string signature(const Entries& entries, const void* object, const std::string& prefix, const std::string& name,
                      const std::string& result, const std::string& others) {
  std::string text = "def " + name + "(" + prefix + ", *";
  for (const Entry& entry : entries) {
    text += ", " + entry.name + ": " + entry.as->type();
    if (!entry.is_required) text += " = " + entry.as->code(static_cast<const char*>(object) + entry.offset);
  }
  return text + (others.empty() ? "" : ", ") + others + ") -> " + result;
}

std::string documentation(const Entries& entries, const std::string& head) {
  std::string lines;
  for (const Entry& entry : entries) {
    if (*entry.doc != '\0') lines += "\n    " + entry.name + ": " + entry.doc;
  }
  if (lines.empty()) return head;
  return head + (head.empty() ? "Args:" : "\n\nArgs:") + lines;
}

// Numbers are taken from any sequence, and given as a list.
std::string attribute_signature(const Entry& entry) {
  static const std::string taken = "collections.abc.Sequence";
  std::string type = entry.as->type();
  for (std::size_t at = 0; (at = type.find(taken, at)) != std::string::npos;) type.replace(at, taken.size(), "list");
  return "def " + entry.name + "(self) -> " + type;
}

void assign(const Entries& entries, void* object, const nb::kwargs& given, const std::string& what) {
  std::size_t used = 0;
  for (const Entry& entry : entries) {
    const std::string& name = entry.name;
    if (!given.contains(name.c_str())) {
      if (entry.is_required) throw nb::type_error((what + " needs " + name).c_str());
      continue;
    }
    ++used;
    const nb::object from = given[name.c_str()];
    void* member = static_cast<char*>(object) + entry.offset;
    try {
      entry.as->assign(member, from);
    } catch (const nb::cast_error&) {
      const auto shown = nb::cast<std::string>(nb::repr(from));
      throw nb::type_error((what + ": " + name + " must be " + entry.as->type() + ", not " + shown).c_str());
    } catch (const std::invalid_argument& error) {
      throw std::invalid_argument(name + " " + error.what());
    }
    if (entry.as->number) check_limits(name, entry.limits, entry.as->number(member));
  }
  if (used == given.size()) return;
  std::string known;
  for (const Entry& entry : entries) known += (known.empty() ? "" : ", ") + entry.name;
  for (const auto& [key, value] : given) {
    const auto name = nb::cast<std::string>(key);
    bool is_known = false;
    for (const Entry& entry : entries) is_known |= name == entry.name;
    if (!is_known) throw nb::type_error((what + " has no " + name + "; it has " + known).c_str());
  }
}

}  // namespace alula::fields

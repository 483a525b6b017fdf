// SPDX-License-Identifier: BSD-3-Clause
#include "param_text.h"

#include <fstream>
#include <sstream>
#include <stdexcept>

namespace core_perception {
namespace bench {
namespace {

/// False where the kind is unknown or a number is missing.
bool readValue(const std::string& kind, std::istream* words, ParamValue* value) {
  double number = 0.0;
  std::string word;
  if (kind == "bool" || kind == "int" || kind == "double") {
    if (!(*words >> number)) return false;
    *value = kind == "bool"  ? ParamValue::ofBool(number != 0.0)
             : kind == "int" ? ParamValue::ofInt(static_cast<int>(number))
                             : ParamValue::ofDouble(number);
    return true;
  }
  if (kind == "string") {
    *words >> word;
    *value = ParamValue::ofString(word);
    return true;
  }
  if (kind == "list") {
    value->kind = ParamValue::Kind::kList;
    while (*words >> word) value->list.push_back(ParamValue::ofString(word));
    return true;
  }
  if (kind == "map") {
    value->kind = ParamValue::Kind::kStruct;
    while (*words >> word >> number) value->members[word] = ParamValue::ofDouble(number);
    return true;
  }
  return false;
}

}  // namespace

SemanticMapParams readParams(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": parameters cannot be read");
  ParamMap values;
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string key, kind;
    ParamValue value;
    if (!(words >> key >> kind) || !readValue(kind, &words, &value))
      throw std::runtime_error(path + ": got " + line + "; allowed: KEY KIND VALUE");
    values[key] = value;
  }
  return NodeParams::fromMap(values).map;
}

}  // namespace bench
}  // namespace core_perception

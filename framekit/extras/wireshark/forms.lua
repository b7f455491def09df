-- What bytes mean: numbers and texts by their type, check codes, and the content of wraps.

local F = {}

local function reversed_pairs(text)
  return (text:reverse():gsub("(.)(.)", "%2%1"))
end

local function unhex(digits)
  if #digits % 2 == 1 or digits:find("[^0-9A-Fa-f]") then
    return nil
  end
  return (digits:gsub("..", function(pair)
    return string.char(tonumber(pair, 16))
  end))
end

local function tohex(raw)
  return (raw:gsub(".", function(sign)
    return string.format("%02X", sign:byte())
  end))
end

-- The bytes of every unit of some bytes turned round; what fills no unit stays.
local function swap(raw, size)
  local whole = #raw - #raw % size
  local parts = {}
  for place = 1, whole, size do
    parts[#parts + 1] = raw:sub(place, place + size - 1):reverse()
  end
  return table.concat(parts) .. raw:sub(whole + 1)
end

local function reorder(raw, order)
  if order == "little" then
    return raw:reverse()
  end
  if order == "BADC" then
    return swap(raw, 2)
  end
  if order == "CDAB" then
    return swap(raw:reverse(), 2)
  end
  return raw
end

-- A number of decimal digits: Lua's own where it is exact.
local function of_digits(text, negative)
  text = text:gsub("^0+(%d)", "%1")
  if #text <= 15 then
    local number = tonumber(text)
    return negative and -number + 0 or number
  end
  return { wide = (negative and "-" or "") .. text }
end

-- The decimal digits of a number of base 256.
local function decimal_of(raw)
  local parts = { 0 }
  for place = 1, #raw do
    local carry = raw:byte(place)
    for index = 1, #parts do
      local value = parts[index] * 256 + carry
      parts[index] = value % 10000000
      carry = math.floor(value / 10000000)
    end
    if carry > 0 then
      parts[#parts + 1] = carry
    end
  end
  local text = string.format("%.0f", parts[#parts])
  for index = #parts - 1, 1, -1 do
    text = text .. string.format("%07.0f", parts[index])
  end
  return text
end

local function unsigned(raw)
  raw = raw:gsub("^%z+(.)", "%1")
  if #raw <= 6 then
    local number = 0
    for place = 1, #raw do
      number = number * 256 + raw:byte(place)
    end
    return number
  end
  return of_digits(decimal_of(raw))
end

local function integer(raw, order, signed)
  raw = reorder(raw, order)
  if not signed or raw:byte(1) < 0x80 then
    return unsigned(raw)
  end
  if #raw <= 6 then
    return unsigned(raw) - 2 ^ (8 * #raw)
  end
  local turned = raw:gsub(".", function(sign)
    return string.char(255 - sign:byte())
  end)
  local place = #turned -- and one more
  local carried = ""
  while place > 0 and turned:byte(place) == 255 do
    carried, place = carried .. "\0", place - 1
  end
  if place > 0 then
    turned = turned:sub(1, place - 1) .. string.char(turned:byte(place) + 1) .. carried
  else
    turned = "\1" .. carried
  end
  return of_digits(decimal_of((turned:gsub("^%z+(.)", "%1"))), true)
end

-- IEEE 754 of 2, 4 or 8 bytes, highest first.
local function float(raw)
  local bits = ({ [2] = 5, [4] = 8, [8] = 11 })[#raw]
  local first, second = raw:byte(1, 2)
  local sign = first >= 0x80 and -1 or 1
  local head = first % 0x80 * 256 + second -- 15 bits, the exponent first
  local rest = 15 - bits
  local exponent = math.floor(head / 2 ^ rest)
  local fraction = head % 2 ^ rest
  for place = 3, #raw do
    fraction = fraction * 256 + raw:byte(place)
  end
  local size = rest + 8 * (#raw - 2)
  local bias = 2 ^ (bits - 1) - 1
  if exponent == 2 ^ bits - 1 then
    return fraction == 0 and sign * math.huge or 0 / 0
  end
  if exponent == 0 then
    return sign * fraction * 2 ^ (1 - bias - size)
  end
  return sign * (1 + fraction / 2 ^ size) * 2 ^ (exponent - bias)
end

-- ---- decimal text -----------------------------------------------------------------------------------------------

-- The text of a number whose digits are `figures`, times 10 to the power `power`; nil where the form has none for it.
local function build_decimal(negative, figures, power, size, form)
  local number = figures:gsub("^0+", "")
  local behind, tail = form.decimals or 0, ""
  if form.exponent > 0 then
    local place = number ~= "" and #number - 1 + power or 0
    local text = string.format("%.0f", math.abs(place))
    tail = "E" .. (place < 0 and "-" or "+") .. string.rep("0", form.exponent - #text) .. text
    if #tail > form.exponent + 2 then
      return nil
    end
    power = -math.max(#number - 1, 0)
  elseif not form.decimals then
    behind = math.max(-power, 0)
  end
  local surplus = -power - behind
  if surplus > 0 then
    if number:sub(-surplus):find("[^0]") then
      return nil
    end
    number = number:sub(1, math.max(#number - surplus, 0))
  else
    number = number .. string.rep("0", -surplus)
  end
  number = string.rep("0", behind - #number) .. number
  local front = number:sub(1, #number - behind)
  local least = form.digits > 0 and form.digits or (behind == 0 and 1 or 0)
  front = string.rep("0", least - #front) .. front
  local text = front .. ((behind > 0 or form.point) and "." .. number:sub(#number - behind + 1) or "") .. tail
  if negative and form.sign == "never" then
    return nil
  end
  local sign = negative and "-" or form.sign == "always" and "+" or form.sign == "space" and " " or ""
  local room = (size or 256) - #sign - #text
  if room < 0 then
    return nil
  end
  if not size then
    return sign .. text
  end
  if form.fill == "0" then
    return sign .. string.rep("0", room) .. text
  end
  return string.rep(form.fill, room) .. sign .. text
end

local function parse_decimal(raw, fixed, form)
  if form.empty and raw == "" then
    return X.nothing
  end
  local plain = raw
  if fixed and form.fill ~= "0" then
    local from = 1
    while plain:sub(from, from) == form.fill do
      from = from + 1
    end
    plain = plain:sub(from)
  end
  if form.sign == "space" then
    plain = plain:gsub("^ ", "")
  end
  local sign, front, point, behind, tail = plain:match("^([+-]?)(%d*)(%.?)(%d*)(.*)$")
  if not sign or #raw > 256 or front .. behind == "" or (point == "" and behind ~= "") then
    return nil
  end
  local power = 0
  if tail ~= "" then
    local exponent = tail:match("^E([+-]%d%d?%d?%d?)$")
    if not exponent then
      return nil
    end
    power = tonumber((exponent:gsub("^%+", "")))
  end
  local figures = front .. behind
  local whole = form.decimals == 0 and form.exponent == 0 and not form.point and point == "" and tail == ""
  local negative = sign == "-" and not (whole and not figures:find("[^0]"))
  if build_decimal(negative, figures, power - #behind, fixed and #raw or nil, form) ~= raw then
    return nil
  end
  if whole then
    return of_digits(figures, negative)
  end
  local shown = (sign == "-" and "-" or "") .. (front == "" and "0" or front) .. "." .. (behind == "" and "0" or behind)
  return tonumber(shown .. (tail ~= "" and "e" .. string.format("%.0f", power) or "")) + 0
end

-- ---- types ------------------------------------------------------------------------------------------------------

-- The value of bytes by their type; nil where they are none.
local function parse(of, raw)
  local kind = of.kind
  if kind == "int" then
    return integer(raw, of.order, of.signed)
  elseif kind == "float" then
    return float(reorder(raw, of.order))
  elseif kind == "hex_int" or kind == "hex_float" then
    local plain = unhex(raw)
    if not plain then
      return nil
    end
    return kind == "hex_int" and integer(plain, of.order, true) or float(reorder(plain, of.order))
  elseif kind == "digits" then
    if of.order == "little" then
      if of.base == 16 then
        if #raw % 2 == 1 then
          return nil
        end
        raw = reversed_pairs(raw)
      else
        raw = raw:reverse()
      end
    end
    if raw == "" then
      return nil
    end
    if of.base == 16 then
      local plain = unhex(#raw % 2 == 1 and "0" .. raw or raw)
      return plain and unsigned(plain)
    elseif of.base == 10 then
      return not raw:find("%D") and of_digits(raw) or nil
    elseif raw:find("[^0-7]") then
      return nil
    end
    return #raw <= 17 and tonumber(raw, 8) or X.limit("an octal number of more than 17 digits")
  elseif kind == "bcd" then
    local digits = tohex(of.order == "little" and raw:reverse() or raw)
    return not digits:find("%D") and digits ~= "" and of_digits(digits) or nil
  elseif kind == "decimal" or kind == "fraction" then
    return parse_decimal(raw, of.fixed, of.form)
  elseif kind == "scaled" then
    local number = parse(of.inside, raw)
    if number == nil or number == X.nothing then
      return number
    end
    if type(number) ~= "number" then
      X.limit("a scaled number of more than 53 bits")
    end
    return X.add(X.mul(number, of.factor), of.offset) / 10 ^ of.places
  elseif kind == "ascii" then
    if of.stop then
      local place = raw:find(of.stop, 1, true)
      raw = place and raw:sub(1, place - 1) or raw
    end
    if of.pad then
      local last = #raw
      while last > 0 and raw:sub(last, last) == of.pad do
        last = last - 1
      end
      raw = raw:sub(1, last)
    end
    return raw
  end
  return X.bytes(raw)
end
F.parse = parse

-- The number of `size` bytes or digits, as check codes and added bytes are written.
local function be(number, size)
  local parts = {}
  for place = size, 1, -1 do
    local low = number % 256
    parts[place] = string.char(low)
    number = (number - low) / 256
  end
  return table.concat(parts)
end

local function nibbles(raw)
  return (raw:gsub(".", function(sign)
    local byte = sign:byte()
    return string.char(0x30 + math.floor(byte / 16), 0x30 + byte % 16)
  end))
end

local function written(number, form, size, little)
  if form == "raw" then
    local raw = be(number, size)
    return little and raw:reverse() or raw
  elseif form == "dec" then
    local text = string.format("%.0f", number)
    text = string.rep("0", size - #text) .. text
    return little and text:reverse() or text
  elseif form == "nibbles" then
    local raw = be(number, math.floor(size / 2))
    return nibbles(little and raw:reverse() or raw)
  end
  local text = tohex(be(number, math.ceil(size / 2))):sub(-size)
  text = little and reversed_pairs(text) or text
  return form == "hex" and text:lower() or text
end

-- Bytes that count in a check code and are not on the wire.
function F.added(of, number)
  if not of then
    return number.raw
  end
  number = number < 0 and number + 2 ^ (8 * of.size) or number
  if of.kind == "int" then
    return reorder(be(number, of.size), of.order)
  elseif of.kind == "digits" then
    local form = of.base == 10 and "dec" or of.upper and "HEX" or "hex"
    return of.base ~= 8 and written(number, form, of.size, of.order == "little")
      or string.rep("0", of.size - #string.format("%o", number)) .. string.format("%o", number)
  elseif of.kind == "bcd" then
    local text = string.format("%.0f", number)
    local raw = unhex(string.rep("0", 2 * of.size - #text) .. text)
    return of.order == "little" and raw:reverse() or raw
  end
  return X.limit("added bytes of this type")
end

-- ---- check codes ------------------------------------------------------------------------------------------------

local function mirrored(value, width)
  local found = 0
  for _ = 1, width do
    found = found * 2 + value % 2
    value = math.floor(value / 2)
  end
  return found
end

local tables = {}

local function crc_table(method)
  local known = tables[method]
  if known then
    return known
  end
  known = {}
  local width = method.width
  if method.refin then
    local poly = mirrored(method.poly, width)
    for index = 0, 255 do
      local code = index
      for _ = 1, 8 do
        local low = code % 2
        code = math.floor(code / 2)
        if low == 1 then
          code = bxor(code, poly) % 2 ^ 32
        end
      end
      known[index] = code
    end
  else
    local size = math.max(width, 8)
    local poly, top = method.poly * 2 ^ (size - width), 2 ^ (size - 1)
    for index = 0, 255 do
      local code = index * 2 ^ (size - 8)
      for _ = 1, 8 do
        if code >= top then
          code = bxor((code - top) * 2, poly) % 2 ^ 32
        else
          code = code * 2
        end
      end
      known[index] = code
    end
  end
  tables[method] = known
  return known
end

local function crc(method, raw)
  local steps, width = crc_table(method), method.width
  local code
  if method.refin then
    code = mirrored(method.initial, width)
    for place = 1, #raw do
      local low = bxor(code % 256, raw:byte(place)) % 2 ^ 32
      code = bxor(math.floor(code / 256), steps[low]) % 2 ^ 32
    end
  else
    local size = math.max(width, 8)
    local part = 2 ^ (size - 8)
    code = method.initial * 2 ^ (size - width)
    for place = 1, #raw do
      local high = bxor(math.floor(code / part), raw:byte(place)) % 2 ^ 32
      code = bxor(code % part * 256, steps[high]) % 2 ^ 32
    end
    code = math.floor(code / 2 ^ (size - width))
  end
  if method.refin ~= method.refout then
    code = mirrored(code, width)
  end
  return bxor(code, method.xorout) % 2 ^ 32
end

local function words(raw, order)
  local place = 1
  return function()
    if place > #raw then
      return nil
    end
    local first, second = raw:byte(place), raw:byte(place + 1) or 0
    place = place + 2
    return order == "little" and first + 256 * second or 256 * first + second
  end
end

local work = {}

function work.sum(method, raw)
  local total = method.initial
  for place = 1, #raw do
    total = total + raw:byte(place)
  end
  return total
end
work.sum7 = work.sum

function work.word_sum(method, raw)
  local total = method.initial
  for word in words(raw, method.order) do
    total = total + word
  end
  return total
end

function work.xor(method, raw)
  local size = math.max(1, math.floor((method.width + 7) / 8))
  raw = raw .. string.rep("\0", -#raw % size)
  local code = method.initial
  for place = 1, #raw, size do
    local word = raw:sub(place, place + size - 1)
    code = X.bxor(code, unsigned(method.order == "little" and word:reverse() or word))
  end
  return code
end
work.xor7 = work.xor

work["or"] = function(method, raw)
  local code = method.initial
  for place = 1, #raw do
    code = X.bor(code, raw:byte(place))
  end
  return code
end

function work.multiply(method, raw)
  local code = method.initial
  for place = 1, #raw do
    code = code * raw:byte(place) % 2 ^ method.width
  end
  return code
end

function work.fold(method, raw)
  local code = method.initial
  for place = 1, #raw do
    code = X.band(method.fold(code, raw:byte(place)), 2 ^ method.width - 1)
  end
  return code
end

-- The number that a check code is over some bytes.
local function code_of(method, raw)
  if method.kind == "crc" then
    local code = crc(method, raw)
    return method.mask and X.band(code, method.mask) or code
  end
  local code = work[method.kind](method, raw)
  local width = (method.kind == "sum7" or method.kind == "xor7") and math.min(method.width, 7) or method.width
  if method.complement == "ones" then
    code = -code - 1
  elseif method.complement == "twos" then
    code = -code
  end
  code = code % 2 ^ width
  return method.mask and X.band(code, method.mask) or code
end
F.code_of = code_of

-- The bytes of a check code as they have to stand on the wire.
function F.code_bytes(check, raw)
  local code = code_of(check.method, raw)
  local bits = ({ raw = 8, nibbles = 4, hex = 4, HEX = 4 })[check.form]
  if bits and check.method.width > bits * check.size then
    code = code % 2 ^ (bits * check.size)
  end
  return written(code, check.form, check.size, check.order == "little")
end

-- ---- wraps ------------------------------------------------------------------------------------------------------
--
-- Each function gives the content and the place of each of its bytes and of its end on the wire; where it cannot be
-- read, no content, and the cause. The last place is that of the fault then.

local open = {}
F.open = open

local function straight(size)
  local places = {}
  for place = 0, size do
    places[place + 1] = place
  end
  return places
end

function open.none(_, raw)
  return raw, straight(#raw)
end

function open.hex(_, raw)
  local places = {}
  for place = 0, #raw - 1, 2 do
    if not unhex(raw:sub(place + 1, place + 2)) or #raw < place + 2 then
      return "", { place }, "digits"
    end
    places[#places + 1] = place
  end
  places[#places + 1] = #raw
  return unhex(raw), places
end

function open.doubled(of, raw)
  local plain, places, place = {}, {}, 0
  while place < #raw do
    local skipped = false
    for _, frame in ipairs(of.embedded) do
      if raw:sub(place + 1, place + #frame) == frame then
        place, skipped = place + #frame, true
        break
      end
    end
    if not skipped then
      local byte = raw:byte(place + 1)
      places[#places + 1], plain[#plain + 1] = place, string.char(byte)
      if byte == of.escape then
        place = place + 1
        if raw:byte(place + 1) ~= byte then
          return "", { place - 1 }, "constant"
        end
      end
      place = place + 1
    end
  end
  places[#places + 1] = #raw
  return table.concat(plain), places
end

function open.escaped(of, raw)
  local plain, places, place = {}, {}, 0
  while place < #raw do
    places[#places + 1] = place
    local byte = raw:byte(place + 1)
    if byte == of.escape then
      local code = raw:byte(place + 2)
      local meant = code and of.plain[code]
      if code and not meant and of.flip and not of.never:find(string.char(code), 1, true) then
        meant = bxor(code, of.flip) % 256
      end
      if not meant then
        return "", places, "constant"
      end
      plain[#plain + 1], place = string.char(meant), place + 2
    elseif of.never:find(string.char(byte), 1, true) then
      return "", places, "constant"
    else
      plain[#plain + 1], place = string.char(byte), place + 1
    end
  end
  places[#places + 1] = #raw
  return table.concat(plain), places
end

function open.cobs(_, raw)
  local plain, places, place = {}, {}, 0
  while place < #raw do
    local size = raw:byte(place + 1)
    local group = raw:sub(place + 2, place + size)
    if size == 0 or #group < size - 1 or group:find("%z") then
      places[#places + 1] = place
      return "", places, "constant"
    end
    plain[#plain + 1] = group
    for at = place + 1, place + size - 1 do
      places[#places + 1] = at
    end
    place = place + size
    if size < 255 and place < #raw then
      plain[#plain + 1], places[#places + 1] = "\0", place
    end
  end
  if raw == "" then
    return "", { 0 }, "constant"
  end
  local content = table.concat(plain)
  if content ~= "" then
    places[1] = 0
  end
  places[#places + 1] = #raw
  return content, places
end

function open.inserted(of, raw)
  local plain, places, start = {}, {}, 1
  while true do
    local place = raw:find(of.after, start, true)
    local stop = place and place + #of.after or #raw + 1
    plain[#plain + 1] = raw:sub(start, stop - 1)
    for at = start - 1, stop - 2 do
      places[#places + 1] = at
    end
    if not place then
      break
    end
    if raw:sub(stop, stop + #of.insert - 1) ~= of.insert then
      places[#places + 1] = place - 1
      return "", places, "constant"
    end
    start = stop + #of.insert
  end
  places[#places + 1] = #raw
  return table.concat(plain), places
end

function open.blocks(of, raw)
  local plain, places, bad, expected, found = {}, {}, nil, nil, nil
  local width = of.check.size
  for place = 0, #raw - 1, of.size + width do
    local part = raw:sub(place + 1, place + of.size + width)
    local block, there = part:sub(1, -width - 1), part:sub(-width)
    if block == "" then
      places[#places + 1] = place
      return "", places, "short"
    end
    local wanted = F.code_bytes(of.check, block)
    local right = there == wanted or (of.check.digits and there:upper() == wanted:upper())
    if not bad and not right then
      expected, found, bad = wanted, there, place + #block
    end
    plain[#plain + 1] = block
    for at = place, place + #block - 1 do
      places[#places + 1] = at
    end
  end
  places[#places + 1] = #raw
  if bad then
    return table.concat(plain), places, "check", expected, found, bad
  end
  return table.concat(plain), places
end

function open.short(of, raw)
  if #raw < of.least then
    return "", { #raw }, "short"
  elseif #raw > of.size then
    return "", { of.size }, "too_long"
  end
  local places = {}
  for place = 0, of.size do
    places[place + 1] = math.min(place, #raw)
  end
  return raw .. string.rep(of.fill, of.size - #raw), places
end

function open.cannot(of)
  return X.limit(of.why)
end

F.unhex, F.tohex, F.swap = unhex, tohex, swap
